// @ts-check
// One camera image on a canvas, with zoom, and drawings in pixels of the image.
import "./types.js";

const COLORS = { region: "#ffffff", shadow: "#000000", axes: ["#ff5a5a", "#45d36b", "#5aa8ff"], line: "#ffd84d" };
/** Colours and line styles of the statuses: they differ in brightness and dashes, too. */
export const STATUS = /** @type {Record<string, {color: string, dash: number[], sign: string}>} */ ({
  ok: { color: "#56b4e9", dash: [], sign: "✓" },
  "weak-tilt": { color: "#f0e442", dash: [10, 4], sign: "≈" },
  "partly-observed": { color: "#f0e442", dash: [10, 4], sign: "≈" },
  ambiguous: { color: "#ff9a4d", dash: [4, 4], sign: "?" },
  lost: { color: "#ff7fae", dash: [2, 6], sign: "✗" },
  "not-observable": { color: "#ff7fae", dash: [2, 6], sign: "✗" },
  error: { color: "#ff7fae", dash: [2, 6], sign: "✗" },
  none: { color: "#9fb0bf", dash: [], sign: "·" },
});
const ZOOM_MAX = 40;

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
    /** Frozen while somebody draws. */
    this.isFrozen = false;
    this.zoom = 1;
    // The pixel in the upper left corner.
    /** @type {import("./types.js").Pixel} */
    this.corner_px = [-0.5, -0.5];
    /** Draws over the image, in pixels of the image. */
    this.paint = (/** @type {ImageView} */ _view) => {};
    this.isStale = false;
    this.drawn = 0;
    new ResizeObserver(() => this.fit()).observe(canvas);
    this.fit();
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
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

  /** @param {import("./types.js").CameraImage} image */
  show(image) {
    if (this.isFrozen) {
      image.bitmap.close();
      return;
    }
    this.image?.bitmap.close();
    this.image = image;
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
      this.drawn += 1;
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
    const before = this.pixelAt(event);
    this.zoom = Math.min(ZOOM_MAX, Math.max(1, this.zoom * Math.exp(-event.deltaY * 0.0015)));
    const after = this.pixelAt(event);
    this.move(before[0] - after[0], before[1] - after[1]);
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
    COLORS.axes.forEach((color, axis) => this.lines([axes[0], axes[axis + 1]], { color, width: 3, closed: false }));
  }

  /** @param {import("./types.js").Pixel[]} points */
  epipolar(points) {
    this.lines(points, { color: COLORS.line, width: 1.5, closed: false });
  }
}
