// @ts-check
// Marks a target in the left image: rectangle, polygon or click, by mouse, finger or keys. The pair is frozen while somebody draws.
import "./types.js";
import { at, make } from "./dom.js";

/** @typedef {"rectangle"|"polygon"|"click"|"push"|"move"} Tool */

const TOOLS = /** @type {{tool: Tool, name: string, key: string, help: string}[]} */ ([
  { tool: "rectangle", name: "Rectangle", key: "r", help: "drag over the object, drag a corner to change it; or arrow keys, Enter, arrow keys, Enter (key R)" },
  { tool: "polygon", name: "Polygon", key: "p", help: "click the corners, Enter or double click ends, drag a corner to change it; or arrow keys and Enter, Enter again ends (key P)" },
  { tool: "click", name: "Click", key: "c", help: "a region of one colour grows from the pixel; or arrow keys, Enter (key C)" },
  { tool: "move", name: "Move image", key: "m", help: "drag the magnified image; the wheel magnifies (key M)" },
]);
const PUSH = { tool: /** @type {Tool} */ ("push"), name: "Push target", key: "t", help: "drag the simulated target about (key T)" };
/** A smaller drag is no rectangle. */
const DRAG_MIN_PX = 4;
const GRASP_PX = 8;
const KEY_STEP_PX = 1;
const KEY_STRIDE_PX = 10;
const ARROWS = /** @type {Record<string, import("./types.js").Pixel>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] });

export class Pointing {
  /**
   * @param {import("./view.js").ImageView} view
   * @param {{onRaw: () => void, onFreeze: (sequence: number|null) => void, onCursor: (u: number, v: number) => void, onBegin: () => void, onRegion: (region: string) => void, onCancel: () => void, onPush: (du: number, dv: number) => void, canPush: boolean, canMark: boolean}} handlers
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
    /** Where the arrow keys point. @type {import("./types.js").Pixel|null} */
    this.cursor_px = null;
    /** Whether the arrow keys were used since the last corner. */
    this.cursorMoved = false;
    // Sum of the pushes, pixels.
    /** @type {import("./types.js").Pixel} */
    this.pushed_px = [0, 0];
    const tools = handlers.canMark ? TOOLS : TOOLS.filter(({ tool }) => tool === "move");
    this.tools = handlers.canPush ? [...tools, PUSH] : tools;
    for (const { tool, name, help } of this.tools) {
      const button = make("button", { type: "button", "data-tool": tool, title: help }, name);
      button.addEventListener("click", () => this.choose(tool));
      at("tools").append(button);
    }
    this.choose(this.tools[0].tool);
    const { canvas } = view;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", () => this.abort());
    canvas.addEventListener("blur", () => this.hideCursor());
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
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const chosen = this.tools.find(({ key }) => key === event.key.toLowerCase());
    if (event.key in ARROWS) this.arrow(ARROWS[event.key], event.shiftKey ? KEY_STRIDE_PX : KEY_STEP_PX);
    else if (event.key === "Escape") this.cancel();
    else if (event.key === "Enter") this.enter();
    else if (event.key === "Backspace") this.removeCorner();
    else if (event.key === "+" || event.key === "-") this.view.zoomStep(event.key === "+" ? 1 : -1);
    else if (chosen) this.choose(chosen.tool);
    else return;
    event.preventDefault();
  }

  /** @param {import("./types.js").Pixel} direction @param {number} step_px */
  arrow([du, dv], step_px) {
    if (this.tool === "move") {
      this.view.move(du * KEY_STRIDE_PX, dv * KEY_STRIDE_PX);
      return;
    }
    if (this.tool === "push") {
      this.push(du * step_px, dv * step_px);
      return;
    }
    const [width, height] = this.view.size_px;
    const [u, v] = this.cursor_px ?? [Math.round(width / 2), Math.round(height / 2)];
    this.cursor_px = [Math.min(width - 1, Math.max(0, u + du * step_px)), Math.min(height - 1, Math.max(0, v + dv * step_px))];
    this.cursorMoved = true;
    if (this.tool === "rectangle" && this.isDrawing) this.points[1] = this.cursor_px;
    this.handlers.onCursor(...this.cursor_px);
    this.view.redraw();
  }

  /** Enter: a corner at the place of the arrow keys, or the end of the region. */
  enter() {
    const cursor_px = this.cursor_px;
    if (!cursor_px || !this.cursorMoved) {
      this.finishPolygon();
      return;
    }
    if (this.tool === "rectangle" && this.isDrawing) this.finishRectangle();
    else if (this.begin(cursor_px) && this.tool === "click") this.give();
    this.cursorMoved = false;
  }

  hideCursor() {
    this.cursor_px = null;
    this.view.redraw();
  }

  removeCorner() {
    if (this.tool !== "polygon" || !this.isDrawing) return;
    this.points.pop();
    if (this.points.length === 0) this.cancel();
    else this.view.redraw();
  }

  cancel() {
    const had = this.points.length > 0;
    this.points = [];
    this.isDrawing = false;
    this.grasped = null;
    this.handlers.onFreeze(null);
    if (had) this.handlers.onCancel();
  }

  /** A second finger, or the browser, took the pointer away. */
  abort() {
    const began = this.from_px !== null && this.grasped === null;
    this.from_px = null;
    this.grasped = null;
    if (!began) return;
    if (this.tool === "polygon") this.removeCorner();
    else if (this.tool === "rectangle" || this.tool === "click") this.cancel();
  }

  /** @param {PointerEvent} event */
  down(event) {
    if (this.view.isMoving) {
      this.abort();
      return;
    }
    if (event.button !== 0 || !this.view.image) return;
    this.view.canvas.setPointerCapture(event.pointerId);
    this.view.canvas.focus();
    this.hideCursor();
    const at_px = this.view.pixelAt(event);
    if (this.tool === "move" || this.tool === "push" || this.grasp(at_px) || this.begin(at_px)) this.from_px = at_px;
  }

  /** Takes a corner of a region, if one is near. @param {import("./types.js").Pixel} at_px */
  grasp(at_px) {
    const isNear = (/** @type {import("./types.js").Pixel} */ [u, v]) =>
      Math.hypot(u - at_px[0], v - at_px[1]) * this.view.scale < GRASP_PX * (window.devicePixelRatio || 1);
    if (this.tool === "rectangle" && !this.isDrawing && this.points.length === 2) {
      const [[u0, v0], [u1, v1]] = this.points;
      const corners = /** @type {import("./types.js").Pixel[]} */ ([[u0, v0], [u1, v0], [u1, v1], [u0, v1]]);
      const near = corners.findIndex(isNear);
      if (near < 0) return false;
      this.points = [corners[(near + 2) % 4], corners[near]];
      this.grasped = 1;
      return true;
    }
    const near = this.tool === "polygon" ? this.points.findIndex(isNear) : -1;
    if (near < 0) return false;
    this.grasped = near;
    return true;
  }

  /** Begins a region, or adds a corner. Regions are in pixels of the raw image. @param {import("./types.js").Pixel} at_px */
  begin(at_px) {
    const { view } = this;
    if (!view.image) return false;
    if (view.image.isRectified) {
      this.handlers.onRaw();
      return false;
    }
    if (!view.isFrozen) {
      this.handlers.onFreeze(view.image.sequence);
      this.handlers.onBegin();
    }
    if (this.tool === "polygon") {
      if (!this.isDrawing && this.points.length > 0) this.handlers.onCancel();
      this.points = this.isDrawing ? [...this.points, at_px] : [at_px];
      this.isDrawing = true;
    } else {
      if (this.points.length > 0) this.handlers.onCancel();
      this.isDrawing = this.tool === "rectangle";
      this.points = this.isDrawing ? [at_px, at_px] : [at_px];
    }
    view.redraw();
    return true;
  }

  /** @param {number} du @param {number} dv */
  push(du, dv) {
    this.pushed_px = [this.pushed_px[0] + du, this.pushed_px[1] + dv];
    this.handlers.onPush(this.pushed_px[0], this.pushed_px[1]);
  }

  /** @param {PointerEvent} event */
  move(event) {
    if (this.view.isMoving) return;
    const at_px = this.view.pixelAt(event);
    if (this.grasped !== null) {
      this.points[this.grasped] = at_px;
    } else if (this.from_px && this.tool === "rectangle" && this.isDrawing) {
      this.points[1] = at_px;
    } else if (this.from_px && this.tool === "move") {
      this.view.move(this.from_px[0] - at_px[0], this.from_px[1] - at_px[1]);
      return;
    } else if (this.from_px && this.tool === "push") {
      this.push(at_px[0] - this.from_px[0], at_px[1] - this.from_px[1]);
      this.from_px = at_px;
      return;
    } else return;
    this.view.redraw();
  }

  /** @param {PointerEvent} event */
  up(event) {
    if (this.view.isMoving) return;
    const at_px = this.view.pixelAt(event);
    const from_px = this.from_px;
    this.from_px = null;
    if (this.grasped !== null) {
      this.grasped = null;
      if (!this.isDrawing) this.give();
    } else if (this.tool === "click" && from_px) {
      this.points = [at_px];
      this.give();
    } else if (this.tool === "rectangle" && this.isDrawing && from_px) {
      this.finishRectangle();
    }
  }

  finishRectangle() {
    this.isDrawing = false;
    const [[u0, v0], [u1, v1]] = this.points;
    if (Math.abs(u1 - u0) < DRAG_MIN_PX || Math.abs(v1 - v0) < DRAG_MIN_PX) this.cancel();
    else this.give();
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
      const corners = /** @type {import("./types.js").Pixel[]} */ ([[u0, v0], [u1, v0], [u1, v1], [u0, v1]]);
      view.lines(corners, { dash: [6, 4] });
      if (!this.isDrawing) corners.forEach((corner) => view.dot(corner));
    } else if (points.length > 1) {
      view.lines(points, { dash: [6, 4], closed: !this.isDrawing });
    }
    if (this.tool === "polygon" || points.length === 1) points.forEach((point) => view.dot(point));
    if (this.cursor_px) view.crosshair(this.cursor_px);
  }
}
