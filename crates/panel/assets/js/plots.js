// @ts-check
// Plots of the last minute.
import "./types.js";
import { at, make, norm } from "./dom.js";

const SPAN_S = 60;
/** New points per second. */
const RATE_HZ = 10;
const REDRAW_MS = 250;

const PLOTS = /** @type {{title: string, names: string[], of: (state: import("./types.js").State) => (number|null)[]}[]} */ ([
  { title: "error of the hand", names: ["mm", "degrees"], of: ({ control }) => [control.error_mm, control.error_deg] },
  { title: "1 sigma of the pose", names: ["mm", "degrees"], of: ({ target }) => [norm(target.sigma_mm), norm(target.sigma_deg)] },
  { title: "agreement of the images", names: ["fitness"], of: ({ target }) => [target.fitness] },
  { title: "time, ms", names: ["age", "computing"], of: ({ target }) => [target.age_ms, target.latency_ms] },
]);
const LINES = [
  { color: "#0072b2", dash: [] },
  { color: "#d55e00", dash: [6, 3] },
];

export class Plots {
  constructor() {
    /** @type {(number|null)[][][]} */
    this.data = PLOTS.map(({ names }) => [[], ...names.map(() => [])]);
    this.before_s = -Infinity;
    const ink = () => getComputedStyle(document.body).color;
    this.plots = PLOTS.map(({ title, names }, index) => {
      const place = make("div");
      at("plots").append(place);
      const axis = { stroke: ink, grid: { stroke: "#8885", width: 1 }, ticks: { stroke: "#8885" } };
      const series = names.map((name, line) => ({ label: name, stroke: LINES[line].color, dash: LINES[line].dash, width: 2, spanGaps: false }));
      // @ts-ignore: a classic script defines it.
      const plot = new uPlot(
        { title, width: 300, height: 170, scales: { x: { time: false } }, series: [{ label: "s" }, ...series], axes: [{ ...axis }, { ...axis, size: 55 }] },
        this.data[index],
        place,
      );
      new ResizeObserver(() => plot.setSize({ width: place.clientWidth, height: 170 })).observe(place);
      return plot;
    });
    setInterval(() => this.redraw(), REDRAW_MS);
  }

  /** @param {import("./types.js").State} state */
  add(state) {
    const now_s = state.time_ms / 1000;
    if (now_s < this.before_s) this.data.forEach((columns) => columns.forEach((column) => column.splice(0)));
    if (now_s - this.before_s < 1 / RATE_HZ && now_s >= this.before_s) return;
    this.before_s = now_s;
    PLOTS.forEach(({ of }, index) => {
      const columns = this.data[index];
      columns[0].push(now_s);
      of(state).forEach((value, line) => columns[line + 1].push(value));
      const old = columns[0].findIndex((time) => (time ?? 0) >= now_s - SPAN_S);
      if (old > 0) columns.forEach((column) => column.splice(0, old));
    });
  }

  redraw() {
    if (document.hidden) return;
    this.plots.forEach((plot, index) => plot.setData(this.data[index]));
  }
}
