// @ts-check
// One camera image on a canvas, with zoom, and drawings in pixels of the image.
import "./types.js";

const COLORS = { region: "#ffffff", shadow: "#000000", axes: ["#ff5a5a", "#45d36b", "#5aa8ff"], line: "#ffd84d" };
/** Colours and line styles of the statuses: they differ in brightness and dashes, too. */
export const STATUS = /** @type {Record<string, {color: string, dash: number[], sign: string}>} */ ({
  ok: { color: "#56b4e9", dash: [], sign: "✓" },
  "weak-tilt": { color: "#f0e442", dash: [10, 4], sign: "≈" },
  "partly-observed": { color: "#f0e442", dash: [10, 4], sign: "≈" },
  "weak-depth": { color: "#ff9a4d", dash: [4, 4], sign: "?" },
  ambiguous: { color: "#ff9a4d", dash: [4, 4], sign: "?" },
  miscalibrated: { color: "#ff7fae", dash: [2, 6], sign: "✗" },
  lost: { color: "#ff7fae", dash: [2, 6], sign: "✗" },
  "not-observable": { color: "#ff7fae", dash: [2, 6], sign: "✗" },
  error: { color: "#ff7fae", dash: [2, 6], sign: "✗" },
  none: { color: "#9fb0bf", dash: [], sign: "·" },
});
const ZOOM_MAX = 40;
const ZOOM_STEP = 1.5;
const AXIS_NAMES = ["x", "y", "z"];

export class ImageView {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {import("./types.js").Pixel} size_px
   */
  constructor(canvas, size_px) {
    this.canvas = canvas;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    this.size_px = size_px;
    /** @type {import("./types.js").CameraImage|null} */
    this.image = null;
    /** Residual of the images inside the region. @type {import("./types.js").CameraImage|null} */
    this.heat = null;
    /** The image before: both views can be frozen on the same pair. @type {import("./types.js").CameraImage|null} */
    this.older = null;
    /** Sequence of the pair on which somebody draws; no newer image is shown. @type {number|null} */
    this.frozen = null;
    /** Fingers and buttons on the canvas. @type {Map<number, import("./types.js").Pixel>} */
    this.held = new Map();
    /** Whether two fingers or the middle button move the image; no tool acts then. */
    this.isMoving = false;
    /** Whether dragging with the mouse moves the image: no tool uses this view. */
    this.dragMoves = false;
    /** Reads single pixels. @type {OffscreenCanvasRenderingContext2D|null} */
    this.probe = null;
    this.zoom = 1;
    // The pixel in the upper left corner.
    /** @type {import("./types.js").Pixel} */
    this.corner_px = [-0.5, -0.5];
    /** Draws over the image, in pixels of the image. */
    this.paint = (/** @type {ImageView} */ _view) => {};
    this.isStale = false;
    /** Images drawn, and images that a newer one replaced before they were drawn. */
    this.drawn = 0;
    this.skipped = 0;
    this.wasDrawn = true;
    new ResizeObserver(() => this.fit()).observe(canvas);
    this.fit();
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of /** @type {const} */ (["pointerup", "pointercancel", "lostpointercapture"])) {
      canvas.addEventListener(name, (event) => this.letGo(event));
    }
  }

  fit() {
    const ratio = window.devicePixelRatio || 1;
    const width = Math.max(1, Math.round(this.canvas.clientWidth * ratio));
    const height = Math.max(1, Math.round((width * this.size_px[1]) / this.size_px[0]));
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    this.redraw();
  }

  /** Canvas pixels per image pixel. */
  get scale() {
    return (this.canvas.width / this.size_px[0]) * this.zoom;
  }

  get isFrozen() {
    return this.frozen !== null;
  }

  /** @param {import("./types.js").CameraImage} image */
  show(image) {
    if (this.frozen !== null && (image.sequence !== this.frozen || image.isRectified)) {
      image.bitmap.close();
      return;
    }
    if (!this.wasDrawn) this.skipped += 1;
    this.wasDrawn = false;
    this.older?.bitmap.close();
    this.older = this.image;
    this.image = image;
    this.redraw();
  }

  /** Shows this pair until it is called with null. @param {number|null} sequence */
  freeze(sequence) {
    this.frozen = sequence;
    if (sequence !== null && this.image?.sequence !== sequence && this.older?.sequence === sequence) {
      [this.image, this.older] = [this.older, this.image];
    }
    this.redraw();
  }

  /** @param {import("./types.js").CameraImage|null} heat */
  overlay(heat) {
    this.heat?.bitmap.close();
    this.heat = heat;
    this.redraw();
  }

  redraw() {
    if (this.isStale) return;
    this.isStale = true;
    requestAnimationFrame(() => {
      this.isStale = false;
      this.draw();
    });
  }

  draw() {
    const { context, canvas, scale } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    // Centres of pixels are whole numbers.
    context.setTransform(scale, 0, 0, scale, -this.corner_px[0] * scale, -this.corner_px[1] * scale);
    context.imageSmoothingEnabled = scale < 3;
    if (this.image) {
      context.drawImage(this.image.bitmap, -0.5, -0.5, this.size_px[0], this.size_px[1]);
      if (!this.wasDrawn) this.drawn += 1;
      canvas.dataset.shown = this.image.isRectified ? "rectified" : "raw";
      this.wasDrawn = true;
    }
    if (this.heat && !this.isFrozen) {
      const { bitmap, place_px, size_px } = this.heat;
      context.drawImage(bitmap, place_px[0] - 0.5, place_px[1] - 0.5, size_px[0], size_px[1]);
    }
    this.paint(this);
  }

  /** @param {{clientX: number, clientY: number}} event @returns {import("./types.js").Pixel} */
  pixelAt(event) {
    const box = this.canvas.getBoundingClientRect();
    const ratio = this.canvas.width / box.width;
    const { scale, corner_px } = this;
    return [
      ((event.clientX - box.left) * ratio) / scale + corner_px[0],
      ((event.clientY - box.top) * ratio) / scale + corner_px[1],
    ];
  }

  /** @param {WheelEvent} event */
  wheel(event) {
    event.preventDefault();
    this.zoomAt(event, Math.exp(-event.deltaY * 0.0015));
  }

  /** Magnifies around a place of the screen. @param {{clientX: number, clientY: number}} place @param {number} factor */
  zoomAt(place, factor) {
    const before = this.pixelAt(place);
    this.zoom = Math.min(ZOOM_MAX, Math.max(1, this.zoom * factor));
    const after = this.pixelAt(place);
    this.move(before[0] - after[0], before[1] - after[1]);
  }

  /** Magnifies by one step around the middle. @param {1|-1} direction */
  zoomStep(direction) {
    const box = this.canvas.getBoundingClientRect();
    this.zoomAt({ clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 }, ZOOM_STEP ** direction);
  }

  /** @param {PointerEvent} event */
  press(event) {
    this.held.set(event.pointerId, [event.clientX, event.clientY]);
    const isMiddle = event.button === 1;
    if (isMiddle) event.preventDefault();
    const isDrag = this.dragMoves && event.pointerType === "mouse" && event.button === 0;
    if (isMiddle || isDrag || this.held.size === 2) this.isMoving = true;
    if (this.isMoving) this.canvas.setPointerCapture(event.pointerId);
  }

  /** Two fingers magnify and move; the middle button moves. @param {PointerEvent} event */
  drag(event) {
    const before = this.held.get(event.pointerId);
    if (!before) return;
    this.held.set(event.pointerId, [event.clientX, event.clientY]);
    if (!this.isMoving) return;
    const other = [...this.held].find(([id]) => id !== event.pointerId)?.[1];
    const from = this.pixelAt({ clientX: before[0], clientY: before[1] });
    const to = this.pixelAt(event);
    const share = other ? 0.5 : 1;
    this.move((from[0] - to[0]) * share, (from[1] - to[1]) * share);
    if (!other) return;
    const apart = (/** @type {import("./types.js").Pixel} */ [x, y]) => Math.max(1, Math.hypot(x - other[0], y - other[1]));
    const middle = { clientX: (event.clientX + other[0]) / 2, clientY: (event.clientY + other[1]) / 2 };
    this.zoomAt(middle, apart([event.clientX, event.clientY]) / apart(before));
  }

  /** @param {PointerEvent} event */
  letGo(event) {
    this.held.delete(event.pointerId);
    // After the tools have seen the event: the last finger of two is no click.
    if (this.held.size === 0) setTimeout(() => (this.isMoving = this.held.size > 1), 0);
  }

  /** Colour of the shown image at a pixel, or null outside. @param {import("./types.js").Pixel} pixel @returns {number[]|null} */
  colorAt([u, v]) {
    const [column, row] = [Math.round(u), Math.round(v)];
    if (!this.image || column < 0 || row < 0 || column >= this.size_px[0] || row >= this.size_px[1]) return null;
    this.probe ??= new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
    if (!this.probe) return null;
    this.probe.drawImage(this.image.bitmap, -column, -row);
    return [...this.probe.getImageData(0, 0, 1, 1).data.slice(0, 3)];
  }

  /** @param {number} du @param {number} dv */
  move(du, dv) {
    const most = (/** @type {number} */ size) => size - size / this.zoom - 0.5;
    this.corner_px = [
      Math.min(most(this.size_px[0]), Math.max(-0.5, this.corner_px[0] + du)),
      Math.min(most(this.size_px[1]), Math.max(-0.5, this.corner_px[1] + dv)),
    ];
    this.redraw();
  }

  whole() {
    this.zoom = 1;
    this.corner_px = [-0.5, -0.5];
    this.redraw();
  }

  /**
   * @param {import("./types.js").Pixel[]} points
   * @param {{color?: string, dash?: number[], width?: number, closed?: boolean}} style
   */
  lines(points, { color = COLORS.region, dash = [], width = 2, closed = true } = {}) {
    if (points.length < 2) return;
    const { context, scale } = this;
    const ratio = (window.devicePixelRatio || 1) / scale;
    context.beginPath();
    points.forEach(([u, v], index) => (index ? context.lineTo(u, v) : context.moveTo(u, v)));
    if (closed) context.closePath();
    context.setLineDash([]);
    context.strokeStyle = COLORS.shadow;
    context.lineWidth = (width + 2) * ratio;
    context.stroke();
    context.setLineDash(dash.map((length) => length * ratio));
    context.strokeStyle = color;
    context.lineWidth = width * ratio;
    context.stroke();
    context.setLineDash([]);
  }

  /** @param {import("./types.js").Pixel} point @param {string} color */
  dot(point, color = COLORS.region) {
    const { context, scale } = this;
    const ratio = (window.devicePixelRatio || 1) / scale;
    context.beginPath();
    context.arc(point[0], point[1], 4.5 * ratio, 0, 2 * Math.PI);
    context.fillStyle = color;
    context.fill();
    context.strokeStyle = COLORS.shadow;
    context.lineWidth = ratio;
    context.stroke();
  }

  /** @param {import("./types.js").Pixel[]} axes */
  axes(axes) {
    COLORS.axes.forEach((color, axis) => {
      this.lines([axes[0], axes[axis + 1]], { color, width: 3, closed: false });
      this.letter(AXIS_NAMES[axis], axes[axis + 1], color);
    });
  }

  /** Colours alone do not tell the axes apart for everybody. @param {string} text @param {import("./types.js").Pixel} place @param {string} color */
  letter(text, place, color) {
    const { context, scale, corner_px } = this;
    const ratio = window.devicePixelRatio || 1;
    context.save();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.font = `bold ${13 * ratio}px sans-serif`;
    const [x, y] = [(place[0] - corner_px[0]) * scale + 4 * ratio, (place[1] - corner_px[1]) * scale - 3 * ratio];
    context.lineWidth = 3 * ratio;
    context.strokeStyle = COLORS.shadow;
    context.strokeText(text, x, y);
    context.fillStyle = color;
    context.fillText(text, x, y);
    context.restore();
  }

  /** Where the keys point. @param {import("./types.js").Pixel} place */
  crosshair([u, v]) {
    const half = (9 * (window.devicePixelRatio || 1)) / this.scale;
    this.lines([[u - half, v], [u + half, v]], { closed: false });
    this.lines([[u, v - half], [u, v + half]], { closed: false });
  }

  /** @param {import("./types.js").Pixel[]} points */
  epipolar(points) {
    this.lines(points, { color: COLORS.line, width: 1.5, closed: false });
  }
}
