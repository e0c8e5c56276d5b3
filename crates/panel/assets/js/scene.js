// @ts-check
// The cell in three dimensions, as lines: both arms, cameras, target with its axes and its ellipsoid of uncertainty. Lengths in mm.
import "./types.js";

/** @typedef {[number, number, number]} Point */
/** Largest exaggeration of the ellipsoid: 1 sigma of 0.1 mm would be invisible. */
const EXAGGERATED = 100;
const AXIS_MM = 80;
const TURN_PER_PX = 0.008;

/** @param {number[]} a @param {number[]} b Products of 4x4 matrices, row by row. */
function product(a, b) {
  const c = new Array(16).fill(0);
  for (let row = 0; row < 4; row++)
    for (let column = 0; column < 4; column++)
      for (let k = 0; k < 4; k++) c[4 * row + column] += a[4 * row + k] * b[4 * k + column];
  return c;
}

/** @param {number[]} transform @param {Point} point @returns {Point} */
function apply(transform, [x, y, z]) {
  const row = (/** @type {number} */ r) => transform[4 * r] * x + transform[4 * r + 1] * y + transform[4 * r + 2] * z + transform[4 * r + 3];
  return [row(0), row(1), row(2)];
}

/** Inverse of a rigid transform. @param {number[]} t */
function inverse(t) {
  const moved = (/** @type {number} */ c) => -(t[c] * t[3] + t[4 + c] * t[7] + t[8 + c] * t[11]);
  return [t[0], t[4], t[8], moved(0), t[1], t[5], t[9], moved(1), t[2], t[6], t[10], moved(2), 0, 0, 0, 1];
}

/** Rotation about an axis (Rodrigues). @param {number[]} axis @param {number} deg */
function rotation([x, y, z], deg) {
  const [s, c] = [Math.sin((deg * Math.PI) / 180), Math.cos((deg * Math.PI) / 180)];
  const t = 1 - c;
  return [
    t * x * x + c, t * x * y - s * z, t * x * z + s * y, 0,
    t * x * y + s * z, t * y * y + c, t * y * z - s * x, 0,
    t * x * z - s * y, t * y * z + s * x, t * z * z + c, 0,
    0, 0, 0, 1,
  ];
}

export class Scene {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {import("./types.js").Info} info
   */
  constructor(canvas, info) {
    this.canvas = canvas;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    this.info = info;
    this.azimuth = -0.9;
    this.elevation = 0.45;
    this.zoom = 1;
    /** @type {import("./types.js").State|null} */
    this.state = null;
    /** @type {PointerEvent|null} */
    let before = null;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      before = event;
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!before) return;
      this.turn((event.clientX - before.clientX) * TURN_PER_PX, (event.clientY - before.clientY) * TURN_PER_PX);
      before = event;
    });
    canvas.addEventListener("pointerup", () => (before = null));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom = Math.min(8, Math.max(0.3, this.zoom * Math.exp(-event.deltaY * 0.001)));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const turns = /** @type {Record<string, [number, number]>} */ ({ ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] });
      const turn = turns[event.key];
      if (!turn) return;
      event.preventDefault();
      this.turn(...turn);
    });
    setInterval(() => this.draw(), 100);
  }

  /** @param {number} azimuth @param {number} elevation */
  turn(azimuth, elevation) {
    this.azimuth -= azimuth;
    this.elevation = Math.min(1.5, Math.max(-1.5, this.elevation + elevation));
  }

  /** Joints of an arm in the world, and the pose of its tool. @param {number} index */
  arm(index) {
    const { chain, axis, world_from_base, flange_from_tool } = this.info.arms[index];
    const angles = this.state?.arms[index]?.position_deg ?? [];
    let pose = world_from_base;
    const points = [apply(pose, [0, 0, 0])];
    axis.forEach((direction, joint) => {
      pose = product(product(pose, chain[joint]), rotation(direction, angles[joint] ?? 0));
      points.push(apply(pose, [0, 0, 0]));
    });
    pose = product(pose, chain[axis.length] ?? [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    points.push(apply(pose, [0, 0, 0]));
    const world_from_tool = product(pose, flange_from_tool);
    points.push(apply(world_from_tool, [0, 0, 0]));
    return { points, world_from_tool };
  }

  draw() {
    if (document.hidden || !this.state) return;
    const { canvas, context } = this;
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round((canvas.clientWidth * ratio * 3) / 4);
    context.lineCap = "round";
    const arms = this.info.arms.map((_, index) => this.arm(index));
    const all = arms.flatMap(({ points }) => points);
    const target = this.state.target.world_from_model;
    if (target) all.push(apply(target, [0, 0, 0]));
    if (all.length === 0) return;
    const centre = [0, 1, 2].map((axis) => (Math.min(...all.map((p) => p[axis])) + Math.max(...all.map((p) => p[axis]))) / 2);
    const radius = Math.max(300, ...all.map((p) => Math.hypot(p[0] - centre[0], p[1] - centre[1], p[2] - centre[2])));
    const scale = (this.zoom * 0.45 * Math.min(canvas.width, canvas.height * 1.2)) / radius;
    const [sa, ca, se, ce] = [Math.sin(this.azimuth), Math.cos(this.azimuth), Math.sin(this.elevation), Math.cos(this.elevation)];
    const project = (/** @type {Point} */ point) => {
      const [x, y, z] = point.map((value, axis) => value - centre[axis]);
      const right = ca * x + sa * y;
      const away = -sa * x + ca * y;
      return [canvas.width / 2 + scale * right, canvas.height / 2 - scale * (ce * z + se * away)];
    };
    const line = (/** @type {Point[]} */ points, /** @type {string} */ color, /** @type {number} */ width) => {
      context.beginPath();
      points.map(project).forEach(([u, v], index) => (index ? context.lineTo(u, v) : context.moveTo(u, v)));
      context.strokeStyle = color;
      context.lineWidth = width * ratio;
      context.stroke();
    };
    this.floor(line, centre, radius);
    const colors = ["#56b4e9", "#c8a24a"];
    arms.forEach(({ points, world_from_tool }, index) => {
      line(points, colors[index % 2], 4);
      const [u, v] = project(points[0]);
      context.fillStyle = colors[index % 2];
      context.font = `${13 * ratio}px sans-serif`;
      // A target that a person pushes about floats: say why.
      const note = index === 1 && this.info.playground ? " (does not hold the target)" : "";
      context.fillText(this.info.arms[index].name + note, u + 6 * ratio, v);
      if (index === 0 && this.info.hand_from_cam_left) this.cameras(line, product(world_from_tool, this.info.hand_from_cam_left));
    });
    if (target) this.target(line, target);
  }

  /** @param {(points: Point[], color: string, width: number) => void} line @param {number[]} centre @param {number} radius */
  floor(line, centre, radius) {
    const step = 250;
    const count = Math.ceil(radius / step);
    for (let index = -count; index <= count; index++) {
      const [x, y] = [centre[0] + index * step, centre[1] + index * step];
      line([[x, centre[1] - count * step, 0], [x, centre[1] + count * step, 0]], "#8883", 1);
      line([[centre[0] - count * step, y, 0], [centre[0] + count * step, y, 0]], "#8883", 1);
    }
  }

  /** @param {(points: Point[], color: string, width: number) => void} line @param {number[]} world_from_cam_left */
  cameras(line, world_from_cam_left) {
    const t = 60;
    const world_from_cam_right = product(world_from_cam_left, inverse(this.info.cameras.cam_right_from_cam_left));
    for (const world_from_cam of [world_from_cam_left, world_from_cam_right]) {
      const corners = /** @type {Point[]} */ ([[-t, -t, 2 * t], [t, -t, 2 * t], [t, t, 2 * t], [-t, t, 2 * t]]).map((corner) => apply(world_from_cam, corner));
      const eye = apply(world_from_cam, [0, 0, 0]);
      line([...corners, corners[0]], "#56b4e9", 1.5);
      corners.forEach((corner) => line([eye, corner], "#56b4e9", 1));
    }
  }

  /** @param {(points: Point[], color: string, width: number) => void} line @param {number[]} world_from_model */
  target(line, world_from_model) {
    const axes = /** @type {Point[]} */ ([[AXIS_MM, 0, 0], [0, AXIS_MM, 0], [0, 0, AXIS_MM]]);
    const origin = apply(world_from_model, [0, 0, 0]);
    ["#ff5a5a", "#45d36b", "#5aa8ff"].forEach((color, axis) => line([origin, apply(world_from_model, axes[axis])], color, 3));
    const sigma_mm = this.state?.target.sigma_mm;
    if (!sigma_mm) return;
    const turn = Array.from({ length: 33 }, (_, index) => (index * Math.PI) / 16);
    for (const [a, b] of [[0, 1], [1, 2], [0, 2]]) {
      const ring = turn.map((angle) => {
        const point = /** @type {Point} */ ([0, 0, 0]);
        point[a] = EXAGGERATED * sigma_mm[a] * Math.cos(angle);
        point[b] = EXAGGERATED * sigma_mm[b] * Math.sin(angle);
        return apply(world_from_model, point);
      });
      line(ring, "#ffb000", 1.5);
    }
  }

  /** @param {import("./types.js").State} state */
  show(state) {
    this.state = state;
  }
}
