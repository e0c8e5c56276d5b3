// @ts-check
// Plots of the last minute.
import "./types.js";
import { at, fixed, make, norm, write } from "./dom.js";

const SPAN_S = 60;
/** New points per second. */
const RATE_HZ = 10;
const REDRAW_MS = 250;

const HEIGHT_PX = 132;

const PLOTS = /** @type {{title: string, names: string[], decimals: number, of: (state: import("./types.js").State) => (number|null)[]}[]} */ ([
  { title: "pose error of the hand", decimals: 2, names: ["mm", "degrees"], of: ({ control }) => [control.error_mm, control.error_deg] },
  { title: "standard deviation of the pose", decimals: 3, names: ["mm", "degrees"], of: ({ target }) => [norm(target.sigma_mm), norm(target.sigma_deg)] },
  { title: "fitness of the images", decimals: 3, names: ["fitness"], of: ({ target }) => [target.fitness] },
  { title: "age and computing time, ms", decimals: 1, names: ["age", "computing"], of: ({ target }) => [target.age_ms, target.latency_ms] },
]);
/** Lines differ in brightness and dashes. First color: light page, second: dark page. */
const LINES = [
  { light: "#00588f", dark: "#6cc6ff", dash: [] },
  { light: "#b34700", dark: "#ffab5c", dash: [6, 3] },
];

export class Plots {
  constructor() {
    /** @type {(number|null)[][][]} */
    this.data = PLOTS.map(({ names }) => [[], ...names.map(() => [])]);
    this.before_s = -Infinity;
    const isDark = matchMedia("(prefers-color-scheme: dark)");
    const ink = () => getComputedStyle(document.body).color;
    /** Newest values in words, also for readers of the screen. @type {HTMLElement[]} */
    this.values = [];
    this.plots = PLOTS.map(({ title, names }, index) => {
      const place = make("div", { class: "plot" });
      const head = make("p", { class: "plot-head" });
      const value = make("span", { class: "plot-value" });
      this.values.push(value);
      head.append(make("strong", {}, title), value);
      place.append(head);
      at("plots").append(place);
      const axis = { stroke: ink, font: "11px sans-serif", grid: { stroke: "#8884", width: 1 }, ticks: { stroke: "#8884", size: 4 } };
      const series = names.map((name, line) => ({
        label: name,
        stroke: () => LINES[line][isDark.matches ? "dark" : "light"],
        dash: LINES[line].dash,
        width: 2,
        spanGaps: false,
      }));
      // @ts-ignore: a classic script defines it.
      const plot = new uPlot(
        {
          width: 300,
          height: HEIGHT_PX,
          legend: { show: false },
          cursor: { show: false },
          padding: [6, 16, 0, 0],
          scales: { x: { time: false, range: [-SPAN_S, 0] }, y: { range: (/** @type {any} */ _, /** @type {number} */ __, /** @type {number} */ max) => [0, max > 0 ? max * 1.1 : 1] } },
          series: [{}, ...series],
          axes: [{ ...axis, size: 26, values: (/** @type {any} */ _, /** @type {number[]} */ ticks) => ticks.map((tick) => (tick === 0 ? "now" : `${tick} s`)) }, { ...axis, size: 48 }],
        },
        [[], ...names.map(() => [])],
        place,
      );
      new ResizeObserver(() => plot.setSize({ width: place.clientWidth, height: HEIGHT_PX })).observe(place);
      return plot;
    });
    // Axes keep their colours until the size changes: draw them again.
    isDark.addEventListener("change", () => requestAnimationFrame(() => this.plots.forEach((plot) => plot.redraw(false, true))));
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
    this.plots.forEach((plot, index) => {
      const [times, ...values] = this.data[index];
      plot.setData([times.map((time) => (time ?? 0) - this.before_s), ...values]);
      const { names, decimals } = PLOTS[index];
      write(this.values[index], values.map((column, line) => `${line ? "\u2505" : "\u2501"} ${names[line]} ${fixed(column.at(-1), decimals)}`).join("  "));
    });
  }
}
