// @ts-check
// Marks a target in the left image: rectangle, polygon or click. The image is frozen while somebody draws.
import "./types.js";
import { at, make } from "./dom.js";

/** @typedef {"rectangle"|"polygon"|"click"|"push"|"move"} Tool */

const TOOLS = /** @type {{tool: Tool, name: string, key: string, help: string}[]} */ ([
  { tool: "rectangle", name: "Rectangle", key: "r", help: "drag over the object (key R)" },
  { tool: "polygon", name: "Polygon", key: "p", help: "click the corners, Enter or double click ends (key P)" },
  { tool: "click", name: "Click", key: "c", help: "a region of one colour grows from the pixel (key C)" },
  { tool: "move", name: "Move image", key: "m", help: "drag the magnified image; the wheel magnifies (key M)" },
]);
const PUSH = { tool: /** @type {Tool} */ ("push"), name: "Push target", key: "t", help: "drag the simulated target about (key T)" };
/** A smaller drag is no rectangle. */
const DRAG_MIN_PX = 4;
const GRASP_PX = 8;

export class Pointing {
  /**
   * @param {import("./view.js").ImageView} view
   * @param {{onBegin: (u: number, v: number) => void, onRegion: (region: string) => void, onCancel: () => void, onPush: (du: number, dv: number) => void, canPush: boolean}} handlers
   */
  constructor(view, handlers) {
    this.view = view;
    this.handlers = handlers;
    /** @type {Tool} */
    this.tool = "rectangle";
    /** @type {import("./types.js").Pixel[]} */
    this.points = [];
    this.isDrawing = false;
    /** @type {number|null} */
    this.grasped = null;
    /** @type {import("./types.js").Pixel|null} */
    this.from_px = null;
    // Sum of the pushes, pixels.
    /** @type {import("./types.js").Pixel} */
    this.pushed_px = [0, 0];
    this.tools = handlers.canPush ? [...TOOLS, PUSH] : TOOLS;
    for (const { tool, name, help } of this.tools) {
      const button = make("button", { type: "button", "data-tool": tool, title: help }, name);
      button.addEventListener("click", () => this.choose(tool));
      at("tools").append(button);
    }
    this.choose("rectangle");
    const { canvas } = view;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("dblclick", () => this.finishPolygon());
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  /** @param {Tool} tool */
  choose(tool) {
    this.cancel();
    this.tool = tool;
    for (const button of at("tools").querySelectorAll("button")) {
      button.setAttribute("aria-pressed", String(button.dataset.tool === tool));
    }
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const chosen = this.tools.find(({ key }) => key === event.key.toLowerCase());
    if (event.key === "Escape") this.cancel();
    else if (event.key === "Enter") this.finishPolygon();
    else if (chosen && !event.ctrlKey && !event.metaKey) this.choose(chosen.tool);
    else return;
    event.preventDefault();
  }

  cancel() {
    const had = this.points.length > 0;
    this.points = [];
    this.isDrawing = false;
    this.view.isFrozen = false;
    this.view.redraw();
    if (had) this.handlers.onCancel();
  }

  /** @param {PointerEvent} event */
  down(event) {
    if (event.button !== 0 || !this.view.image) return;
    this.view.canvas.setPointerCapture(event.pointerId);
    this.view.canvas.focus();
    const at_px = this.view.pixelAt(event);
    this.from_px = at_px;
    if (this.tool === "move" || this.tool === "push") return;
    const near = (this.tool === "polygon" ? this.points : []).findIndex(
      ([u, v]) => Math.hypot(u - at_px[0], v - at_px[1]) * this.view.scale < GRASP_PX * (window.devicePixelRatio || 1),
    );
    if (near >= 0) {
      this.grasped = near;
      return;
    }
    if (!this.view.isFrozen) this.handlers.onBegin(Math.round(at_px[0]), Math.round(at_px[1]));
    this.view.isFrozen = true;
    if (this.tool === "rectangle") {
      this.points = [at_px, at_px];
      this.isDrawing = true;
    } else if (this.tool === "polygon") {
      if (!this.isDrawing) this.points = [];
      this.isDrawing = true;
      this.points.push(at_px);
    }
    this.view.redraw();
  }

  /** @param {PointerEvent} event */
  move(event) {
    const at_px = this.view.pixelAt(event);
    if (this.grasped !== null) {
      this.points[this.grasped] = at_px;
    } else if (this.from_px && this.tool === "rectangle" && this.isDrawing) {
      this.points[1] = at_px;
    } else if (this.from_px && this.tool === "move") {
      this.view.move(this.from_px[0] - at_px[0], this.from_px[1] - at_px[1]);
      return;
    } else if (this.from_px && this.tool === "push") {
      this.pushed_px = [this.pushed_px[0] + at_px[0] - this.from_px[0], this.pushed_px[1] + at_px[1] - this.from_px[1]];
      this.from_px = at_px;
      this.handlers.onPush(this.pushed_px[0], this.pushed_px[1]);
      return;
    } else return;
    this.view.redraw();
  }

  /** @param {PointerEvent} event */
  up(event) {
    const at_px = this.view.pixelAt(event);
    const from_px = this.from_px;
    this.from_px = null;
    if (this.grasped !== null) {
      this.grasped = null;
      if (!this.isDrawing) this.give();
      return;
    }
    if (this.tool === "click" && from_px) {
      this.points = [at_px];
      this.give();
    } else if (this.tool === "rectangle" && this.isDrawing) {
      this.isDrawing = false;
      const [[u0, v0], [u1, v1]] = this.points;
      if (Math.abs(u1 - u0) < DRAG_MIN_PX || Math.abs(v1 - v0) < DRAG_MIN_PX) this.cancel();
      else this.give();
    }
  }

  finishPolygon() {
    if (this.tool !== "polygon" || !this.isDrawing) return;
    // A double click has added its corner twice.
    this.points = this.points.filter(
      ([u, v], index, all) => index === 0 || Math.hypot(u - all[index - 1][0], v - all[index - 1][1]) > 1,
    );
    if (this.points.length < 3) return;
    this.isDrawing = false;
    this.view.redraw();
    this.give();
  }

  give() {
    const region = this.region();
    if (region) this.handlers.onRegion(region);
  }

  /** The region in the notation of the command line. */
  region() {
    const [width, height] = this.view.size_px;
    const inside = this.points.map(([u, v]) => [
      Math.min(width - 1, Math.max(0, Math.round(u * 10) / 10)),
      Math.min(height - 1, Math.max(0, Math.round(v * 10) / 10)),
    ]);
    if (inside.length === 1) return `click:${Math.round(inside[0][0])},${Math.round(inside[0][1])}`;
    if (inside.length === 2) {
      const [left, right] = [inside[0][0], inside[1][0]].map(Math.round).sort((a, b) => a - b);
      const [top, bottom] = [inside[0][1], inside[1][1]].map(Math.round).sort((a, b) => a - b);
      return `rect:${left},${top},${right - left},${bottom - top}`;
    }
    return inside.length > 2 ? `poly:${inside.map(([u, v]) => `${u},${v}`).join(";")}` : null;
  }

  /** Draws what is marked so far. */
  paint() {
    const { points, view } = this;
    if (points.length === 2 && this.tool === "rectangle") {
      const [[u0, v0], [u1, v1]] = points;
      view.lines([[u0, v0], [u1, v0], [u1, v1], [u0, v1]], { dash: [6, 4] });
    } else if (points.length > 1) {
      view.lines(points, { dash: [6, 4], closed: !this.isDrawing });
    }
    if (this.tool === "polygon" || points.length === 1) points.forEach((point) => view.dot(point));
  }
}
