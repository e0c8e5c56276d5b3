// @ts-check
// The plots of a report, drawn by uPlot, with zoom and hover.
"use strict";
{
  /**
   * Values as whole steps from one to the next, in units of the last decimal; null: no value.
   * @typedef {{decimals: number, steps: (number|null)[]}} Column
   * @typedef {{quantity: string, unit: string}} Quantity
   * @typedef {{x: Column, lines: {is_held: boolean, values: Column}[]}} Table
   * @typedef {{x: Quantity, y: Quantity, marks: {at: number, label: string}[], tables: Table[]}} Data
   */

  const uPlot = /** @type {any} */ (globalThis).uPlot;
  const HEIGHT_PX = 254;
  const MARKS_PX = 24;
  const FONT = "11px system-ui, sans-serif";
  /** The shortest span of the x axis, as a share of the whole one. */
  const SPAN_MIN = 1e-4;
  /** Distances of ticks. */
  const STEPS = Array.from({ length: 25 }, (_, power) => [1, 2, 5].map((step) => Number(`${step}e${power - 12}`))).flat();
  /** Change of the span by a key, and by a pixel of the wheel. */
  const KEY_ZOOM = 2;
  const WHEEL_ZOOM = 1.003;

  const css = (/** @type {string} */ name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);
  const fixed = (/** @type {number} */ value, /** @type {number} */ decimals) => {
    const text = value.toFixed(decimals);
    return text.replace("-", Number(text) === 0 ? "" : "\u2212");
  };
  const withUnit = (/** @type {string} */ text, /** @type {Quantity} */ { unit }) => (unit ? `${text} ${unit}` : text);
  const label = (/** @type {Quantity} */ { quantity, unit }) => (unit ? `${quantity}, ${unit}` : quantity);

  const make = (/** @type {string} */ tag, /** @type {string} */ name, text = "") =>
    Object.assign(document.createElement(tag), { className: name, textContent: text });

  const values = (/** @type {Column} */ { decimals, steps }) => {
    let sum = 0;
    return steps.map((step) => (step === null ? null : (sum += step) / 10 ** decimals));
  };

  /** An x axis, and all plots that share it. */
  class Axis {
    constructor(/** @type {Quantity} */ quantity) {
      this.quantity = quantity;
      /** @type {Plot[]} */
      this.plots = [];
      this.whole = [Infinity, -Infinity];
      this.range = this.whole;
      this.decimals = 0;
      /** Position of the cursor. @type {number|null} */
      this.at = null;
      this.bar = make("div", "axis-bar");
      this.cursor = make("span", "reading");
      this.shown = make("span", "reading");
      this.reset = /** @type {HTMLButtonElement} */ (make("button", "", "Whole run"));
      this.reset.addEventListener("click", () => this.showAll());
      const hint = "Drag, pinch or Ctrl + wheel: zoom. Double click: whole run. Arrow keys on a plot: cursor; + and \u2212: zoom.";
      this.bar.append(this.cursor, this.shown, this.reset, make("small", "", hint));
    }

    add(/** @type {Plot} */ plot) {
      const x = plot.columns[0];
      this.plots.push(plot);
      this.whole = [Math.min(this.whole[0], x[0]), Math.max(this.whole[1], x[x.length - 1])];
      // Four decimals of a second at most, as in the tables.
      this.decimals = Math.min(Math.max(this.decimals, ...plot.data.tables.map((table) => table.x.decimals)), 4);
    }

    text(/** @type {number} */ value) {
      return withUnit(fixed(value, this.decimals), this.quantity);
    }

    showAll() {
      this.show(this.whole[0], this.whole[1]);
    }

    /** Shows a range in all plots, or the part of it that is inside the whole one. */
    show(/** @type {number} */ from, /** @type {number} */ to) {
      const [begin, end] = this.whole;
      const span = Math.min(Math.max(to - from, SPAN_MIN * (end - begin)), end - begin);
      const min = Math.min(Math.max(from, begin), end - span);
      this.range = [min, min + span];
      this.reset.disabled = span >= end - begin;
      this.shown.textContent = `shown: ${this.text(min)} to ${this.text(min + span)}`;
      for (const { uplot } of this.plots) uplot.setScale("x", { min, max: min + span });
    }

    /** Multiplies the span; a position stays where it is. */
    zoom(/** @type {number} */ factor, /** @type {number} */ about) {
      const [from, to] = this.range;
      this.show(about + (from - about) * factor, about + (to - about) * factor);
    }

    /** Moves the cursor in all plots. */
    point(/** @type {number} */ at) {
      this.at = Math.min(Math.max(at, this.whole[0]), this.whole[1]);
      this.cursor.textContent = `${this.quantity.quantity}: ${this.text(this.at)}`;
      for (const plot of this.plots) plot.read(this.at);
    }

    /** Moves the cursor, and the range with it if the cursor would leave it. */
    pointInView(/** @type {number} */ at) {
      const [from, to] = this.range;
      this.point(at);
      const outside = Math.min(at - from, 0) + Math.max(at - to, 0);
      if (outside) this.show(from + outside, to + outside);
    }
  }

  class Plot {
    constructor(/** @type {HTMLElement} */ figure, /** @type {Data} */ data, /** @type {Axis} */ axis) {
      this.data = data;
      this.axis = axis;
      this.title = figure.querySelector("b")?.textContent ?? "";
      this.lines = data.tables.flatMap((table) => table.lines);
      const tables = data.tables.map(({ x, lines }) => [values(x), ...lines.map((line) => values(line.values))]);
      /** A column of x, and one of each line; undefined: the line has no sample here. @type {any[][]} */
      this.columns = tables.length > 1 ? uPlot.join(tables) : tables[0];
      this.legend = [...figure.querySelectorAll("figcaption span")].map((entry, index) => {
        const name = entry.textContent ?? "";
        const reading = make("span", "reading");
        const widest = this.columns[index + 1].reduce((most, value) => Math.max(most, value == null ? 0 : this.value(index, value).length), 0);
        reading.style.minWidth = `${widest}ch`;
        entry.append(reading);
        return { name, key: /** @type {HTMLElement} */ (entry.querySelector(".key")), reading };
      });
      this.uplot = new uPlot(this.options(figure), this.columns, figure);
      figure.classList.add("live");
      axis.add(this);
      new ResizeObserver(() => this.uplot.setSize({ width: figure.clientWidth, height: HEIGHT_PX })).observe(figure);
      this.listen(this.uplot.over);
      this.describe(this.uplot.root);
    }

    options(/** @type {HTMLElement} */ figure) {
      const look = { stroke: () => css("ink"), font: FONT, labelFont: "12px system-ui, sans-serif", labelSize: 18, labelGap: 0 };
      const lines = { stroke: () => css("grid"), width: 1 };
      const axis = (/** @type {Quantity} */ quantity, /** @type {number|function} */ size) => ({
        ...look,
        size,
        label: label(quantity),
        grid: lines,
        ticks: { ...lines, size: 4 },
        incrs: STEPS,
        values: (/** @type {any} */ _, /** @type {number[]} */ ticks, /** @type {any} */ __, /** @type {any} */ ___, /** @type {number} */ step) =>
          ticks.map((tick) => fixed(tick, Math.max(-Math.floor(Math.log10(step) + 1e-9), 0))),
      });
      const sizeOfY = (/** @type {any} */ _, /** @type {string[]|null} */ ticks) => Math.max(46, ...(ticks ?? []).map((tick) => 10 + 6.5 * tick.length));
      const range = (/** @type {any} */ _, /** @type {number|null} */ min, /** @type {number|null} */ max) => {
        if (min === null || max === null) return [0, 1];
        const margin = max - min > 1e-9 * Math.max(1, Math.abs(min), Math.abs(max)) ? 0.05 * (max - min) : 0.5;
        return [min - margin, max + margin];
      };
      return {
        width: figure.clientWidth,
        height: HEIGHT_PX,
        padding: [MARKS_PX, 14, 0, 0],
        legend: { show: false },
        cursor: {
          y: false,
          drag: { x: true, y: false, setScale: false },
          bind: { dblclick: () => () => this.axis.showAll(), mouseleave: () => () => null },
          dataIdx: (/** @type {any} */ _, /** @type {number} */ column, /** @type {number} */ row) => (column ? this.sample(column - 1, row) : row),
        },
        scales: { x: { time: false }, y: { range } },
        series: [{}, ...this.lines.map((line, index) => this.series(line, index))],
        axes: [axis(this.data.x, 26), axis(this.data.y, sizeOfY)],
        hooks: {
          draw: [(/** @type {any} */ uplot) => this.drawMarks(uplot)],
          setScale: [(/** @type {any} */ _, /** @type {string} */ key) => key === "x" && this.placeCursor()],
          setSelect: [(/** @type {any} */ uplot) => this.zoomTo(uplot)],
        },
      };
    }

    series(/** @type {{is_held: boolean}} */ { is_held }, /** @type {number} */ index) {
      const { key } = this.legend[index];
      return {
        stroke: () => getComputedStyle(key).color,
        dash: key.classList.contains("dashed") ? [6, 4] : [],
        width: 1.6,
        paths: is_held ? uPlot.paths.stepped({ align: 1 }) : uPlot.paths.linear(),
      };
    }

    /** The row of the sample of a line at a row: of the nearest one, or of the last one if a line holds its values. */
    sample(/** @type {number} */ line, /** @type {number} */ row) {
      const column = this.columns[line + 1];
      const isHeld = this.lines[line].is_held;
      for (let away = 0; away < column.length; away++) {
        if (column[row - away] !== undefined) return row - away;
        if (!isHeld && column[row + away] !== undefined) return row + away;
      }
      return null;
    }

    value(/** @type {number} */ line, /** @type {number} */ value) {
      return withUnit(fixed(value, this.lines[line].values.decimals), this.data.y);
    }

    /** Shows the values at a position. */
    read(/** @type {number} */ at) {
      const x = this.columns[0];
      const row = this.uplot.valToIdx(at);
      const texts = this.legend.map(({ name, reading }, line) => {
        const sample = this.sample(line, this.lines[line].is_held && x[row] > at ? row - 1 : row);
        const value = sample === null ? null : this.columns[line + 1][sample];
        reading.textContent = value === null ? "\u2013" : this.value(line, value);
        return `${name} ${value === null ? "no value" : reading.textContent}`;
      });
      const root = this.uplot.root;
      root.setAttribute("aria-valuenow", String(at));
      root.setAttribute("aria-valuetext", `${this.axis.text(at)}: ${texts.join(", ")}`);
      this.placeCursor();
    }

    placeCursor() {
      const { at, range } = this.axis;
      if (at === null) return;
      const left = at < range[0] || at > range[1] ? -10 : this.uplot.valToPos(at, "x");
      this.uplot.setCursor({ left, top: 0 }, false);
    }

    zoomTo(/** @type {any} */ uplot) {
      const { left, width } = uplot.select;
      if (width <= 0) return;
      uplot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
      this.axis.show(uplot.posToVal(left, "x"), uplot.posToVal(left + width, "x"));
    }

    /** Marks with their labels above the plot; a label that would overlap its neighbour moves up, or is omitted. */
    drawMarks(/** @type {any} */ uplot) {
      const { ctx } = uplot;
      const ratio = uPlot.pxRatio;
      const { left, top, width, height } = uplot.bbox;
      ctx.save();
      ctx.strokeStyle = css("grey");
      ctx.fillStyle = css("soft");
      ctx.font = FONT.replace("11", String(10 * ratio));
      ctx.textAlign = "center";
      ctx.lineWidth = ratio;
      ctx.setLineDash([2 * ratio, 3 * ratio]);
      const freeFrom = [-Infinity, -Infinity];
      for (const mark of this.data.marks) {
        const at = uplot.valToPos(mark.at, "x", true);
        if (!(at >= left - ratio && at <= left + width + ratio)) continue;
        ctx.beginPath();
        ctx.moveTo(at, top);
        ctx.lineTo(at, top + height);
        ctx.stroke();
        const half = ctx.measureText(mark.label).width / 2;
        const row = freeFrom.findIndex((free) => at - half >= free);
        if (row < 0) continue;
        freeFrom[row] = at + half + 2 * ratio;
        ctx.fillText(mark.label, at, top - (4 + 10 * row) * ratio);
      }
      ctx.restore();
    }

    /** A mouse or a finger moves the cursor; two fingers zoom, and the wheel with Ctrl, which a touchpad also sends for a pinch. */
    listen(/** @type {HTMLElement} */ over) {
      const at = (/** @type {number} */ x) => this.uplot.posToVal(x - over.getBoundingClientRect().left, "x");
      over.addEventListener("wheel", (event) => {
        if (!event.ctrlKey) return;
        event.preventDefault();
        this.axis.zoom(WHEEL_ZOOM ** event.deltaY, at(event.clientX));
      }, { passive: false });
      over.style.touchAction = "pan-y";
      /** Position of each finger on the screen, and what was below it. @type {Map<number, {x: number, at: number}>} */
      const fingers = new Map();
      over.addEventListener("pointerdown", ({ pointerType, pointerId, clientX }) => {
        if (pointerType === "touch") fingers.set(pointerId, { x: clientX, at: at(clientX) });
      });
      over.addEventListener("pointermove", ({ pointerId, clientX }) => {
        const finger = fingers.get(pointerId);
        if (finger) finger.x = clientX;
        const [one, other] = fingers.values();
        if (!other) return this.axis.point(at(clientX));
        // The range in which each finger is above what it was above before.
        const perPixel = (other.at - one.at) / (other.x - one.x);
        const { left, width } = over.getBoundingClientRect();
        const from = one.at - (one.x - left) * perPixel;
        if (perPixel > 0) this.axis.show(from, from + width * perPixel);
      });
      for (const end of /** @type {const} */ (["pointerup", "pointercancel"])) over.addEventListener(end, ({ pointerId }) => fingers.delete(pointerId));
    }

    /** A plot is a slider for readers of the screen: they say its value when keys move the cursor. */
    describe(/** @type {HTMLElement} */ root) {
      root.tabIndex = 0;
      root.setAttribute("role", "slider");
      root.setAttribute("aria-label", this.title);
      root.addEventListener("keydown", (event) => {
        const { axis } = this;
        const [from, to] = axis.range;
        const at = axis.at ?? from;
        /** @type {Record<string, () => void>} */
        const actions = {
          ArrowLeft: () => axis.pointInView(this.neighbour(at, -1)),
          ArrowRight: () => axis.pointInView(this.neighbour(at, 1)),
          PageDown: () => axis.pointInView(at - 0.1 * (to - from)),
          PageUp: () => axis.pointInView(at + 0.1 * (to - from)),
          Home: () => axis.point(from),
          End: () => axis.point(to),
          "+": () => axis.zoom(1 / KEY_ZOOM, at),
          "-": () => axis.zoom(KEY_ZOOM, at),
          Escape: () => axis.showAll(),
        };
        if (event.ctrlKey || event.altKey || event.metaKey || !(event.key in actions)) return;
        event.preventDefault();
        actions[event.key]();
      });
    }

    /** The x of the next sample in a direction. */
    neighbour(/** @type {number} */ at, /** @type {1|-1} */ direction) {
      const x = this.columns[0];
      for (let row = this.uplot.valToIdx(at); row >= 0 && row < x.length; row += direction) if ((x[row] - at) * direction > 0) return x[row];
      return at;
    }
  }

  /** @type {Map<string, Axis>} */
  const axes = new Map();
  for (const script of document.querySelectorAll("figure.plot > script")) {
    const figure = /** @type {HTMLElement} */ (script.parentElement);
    const data = /** @type {Data} */ (JSON.parse(script.textContent ?? ""));
    const name = label(data.x);
    const axis = axes.get(name) ?? new Axis(data.x);
    if (!axes.has(name)) (figure.closest(".panels") ?? figure).before(axis.bar);
    axes.set(name, axis);
    new Plot(figure, data, axis);
  }
  for (const axis of axes.values()) {
    const [begin, end] = axis.whole;
    if (begin === end) axis.whole = [begin - 0.5, end + 0.5];
    for (const { uplot } of axis.plots) {
      uplot.root.setAttribute("aria-valuemin", String(axis.whole[0]));
      uplot.root.setAttribute("aria-valuemax", String(axis.whole[1]));
    }
    axis.showAll();
    axis.point(axis.whole[0]);
  }
  document.getElementById("needs-scripts")?.remove();
  // Canvases do not follow the style sheet.
  const redraw = () => axes.forEach((axis) => axis.plots.forEach(({ uplot }) => uplot.redraw(false, true)));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => requestAnimationFrame(redraw));
  // On paper the colours are those of a light page.
  for (const [event, isPrinted] of /** @type {const} */ ([["beforeprint", true], ["afterprint", false]]))
    addEventListener(event, () => {
      document.documentElement.classList.toggle("printed", isPrinted);
      redraw();
    });
}
