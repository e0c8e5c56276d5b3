// @ts-check
// Joints as bars: angle between the ends of all ranges, and speed below all limits.
import "./types.js";
import { at, fixed } from "./dom.js";

const SVG = "http://www.w3.org/2000/svg";
const [WIDTH, ROW, TEXT] = [340, 18, 192];
/** Left end and length of both bars. */
const [ANGLE, SPEED] = [{ left: 22, length: 164 }, { left: 250, length: 86 }];
/** Share of the operating range above which a joint is near its end. */
const NEAR = 0.9;

/** @param {string} name @param {Record<string, string|number>} attributes @param {string} [text] */
function shape(name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
  if (text !== undefined) element.textContent = text;
  return element;
}

/** @param {number[]} range_deg */
const ends = (range_deg) => `${range_deg.map((deg) => fixed(deg, 1)).join(" to ")}°`;

/** All limits of a joint in words. @param {import("./types.js").JointLimit} limit @param {number} joint */
function told(limit, joint) {
  const gateway = limit.gateway_deg && limit.gateway_speed_deg_per_s !== null
    ? [`gateway ${ends(limit.gateway_deg)}, ${fixed(limit.gateway_speed_deg_per_s, 1)}°/s`]
    : [];
  return [
    `Joint ${joint + 1}: operating ${ends(limit.operating_deg)}, ${fixed(limit.speed_deg_per_s, 1)}°/s`,
    `servo ${ends(limit.servo_deg)}, ${fixed(limit.drive_speed_deg_per_s, 1)}°/s`,
    ...gateway,
    `mechanical ${ends(limit.mechanical_deg)}`,
  ].join("; ");
}

/** One bar with a part for each limit. @param {{left: number, length: number}} bar @param {number[]} whole @param {number} y */
function barOf({ left, length }, whole, y) {
  const [least, most] = [whole[0] ?? 0, whole[1] ?? 1];
  const x = (/** @type {number} */ value) => left + (length * (Math.min(Math.max(value, least), most) - least)) / (most - least);
  const part = (/** @type {string} */ kind, /** @type {number[]} */ range) =>
    shape("rect", { class: kind, x: x(range[0] ?? 0), y: y + 3, width: Math.max(1, x(range[1] ?? 0) - x(range[0] ?? 0)), height: 8 });
  const mark = (/** @type {number} */ value) => shape("rect", { class: "gateway", x: x(value) - 0.75, y: y + 1, width: 1.5, height: 12 });
  const place = shape("rect", { class: "place", y, width: 4, height: 14, x: left });
  return { x, part, mark, place };
}

export class Joints {
  /** @param {import("./types.js").ArmInfo[]} arms */
  constructor(arms) {
    this.arms = arms;
    this.rows = arms.map((arm) => {
      const height = ROW * (arm.joints + 1);
      const drawing = shape("svg", { viewBox: `0 0 ${WIDTH} ${height}`, role: "img", "aria-label": `joints of ${arm.name}` });
      drawing.append(shape("text", { x: 0, y: 13 }, arm.name), shape("text", { x: SPEED.left, y: 13 }, "speed"));
      const rows = arm.limits.map((limit, joint) => {
        const y = ROW * (joint + 1);
        const angle = barOf(ANGLE, limit.mechanical_deg, y);
        const fastest = Math.max(limit.drive_speed_deg_per_s, limit.gateway_speed_deg_per_s ?? 0);
        const speed = barOf(SPEED, [0, fastest], y);
        const text = shape("text", { x: TEXT, y: y + 12 });
        const row = shape("g", {});
        row.append(
          shape("title", {}, told(limit, joint)),
          shape("text", { x: 4, y: y + 12 }, String(joint + 1)),
          angle.part("mechanical", limit.mechanical_deg),
          angle.part("servo", limit.servo_deg),
          angle.part("operating", limit.operating_deg),
          ...(limit.gateway_deg ?? []).map(angle.mark),
          angle.place,
          text,
          speed.part("servo", [0, fastest]),
          speed.part("operating", [0, limit.speed_deg_per_s]),
          ...(limit.gateway_speed_deg_per_s === null ? [] : [speed.mark(limit.gateway_speed_deg_per_s)]),
          speed.place,
        );
        drawing.append(row);
        return { angle, speed, text };
      });
      at("joints").append(drawing);
      return rows;
    });
    at("joints-key").hidden = arms.length === 0;
  }

  /** @param {import("./types.js").ArmState[]} arms */
  show(arms) {
    arms.forEach((arm, index) => {
      arm.position_deg.forEach((deg, joint) => {
        const row = this.rows[index]?.[joint];
        const limit = this.arms[index]?.limits[joint];
        if (!row || !limit) return;
        row.angle.place.setAttribute("x", String(row.angle.x(deg) - 2));
        row.angle.place.setAttribute("class", (arm.near[joint] ?? 0) > NEAR ? "near" : "place");
        const deg_per_s = Math.abs(arm.speed_deg_per_s[joint] ?? 0);
        row.speed.place.setAttribute("x", String(row.speed.x(deg_per_s) - 2));
        row.speed.place.setAttribute("class", deg_per_s > NEAR * limit.speed_deg_per_s ? "near" : "place");
        row.text.textContent = `${fixed(deg, 1)}°`;
      });
    });
  }
}
