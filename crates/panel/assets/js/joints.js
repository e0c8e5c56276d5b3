// @ts-check
// Joints as bars: range of the robot, range of operation, and place.
import "./types.js";
import { at, fixed } from "./dom.js";

const SVG = "http://www.w3.org/2000/svg";
const [WIDTH, ROW, LEFT, BAR] = [320, 18, 30, 220];
/** Share of the operating range above which a joint is near its end. */
const NEAR = 0.9;

/** @param {string} name @param {Record<string, string|number>} attributes */
function shape(name, attributes) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
  return element;
}

export class Joints {
  /** @param {import("./types.js").ArmInfo[]} arms */
  constructor(arms) {
    this.arms = arms;
    this.rows = arms.map((arm) => {
      const height = ROW * (arm.joints + 1);
      const drawing = shape("svg", { viewBox: `0 0 ${WIDTH} ${height}`, role: "img", "aria-label": `joints of ${arm.name}` });
      const title = shape("text", { x: 0, y: 13 });
      title.textContent = arm.name;
      drawing.append(title);
      const rows = arm.limits.map((limit, joint) => {
        const y = ROW * (joint + 1);
        const x = (/** @type {number} */ deg) => LEFT + (BAR * (deg - limit.robot_deg[0])) / (limit.robot_deg[1] - limit.robot_deg[0]);
        const number = shape("text", { x: 4, y: y + 12 });
        number.textContent = String(joint + 1);
        const place = shape("rect", { class: "place", y, width: 4, height: 14, x: LEFT });
        const text = shape("text", { x: LEFT + BAR + 8, y: y + 12 });
        drawing.append(
          number,
          shape("rect", { class: "range", x: LEFT, y: y + 3, width: BAR, height: 8 }),
          shape("rect", { class: "operating", x: x(limit.operating_deg[0]), y: y + 3, width: Math.max(1, x(limit.operating_deg[1]) - x(limit.operating_deg[0])), height: 8 }),
          place,
          text,
        );
        return { x, place, text };
      });
      at("joints").append(drawing);
      return rows;
    });
  }

  /** @param {import("./types.js").ArmState[]} arms */
  show(arms) {
    arms.forEach((arm, index) => {
      arm.position_deg.forEach((deg, joint) => {
        const row = this.rows[index]?.[joint];
        if (!row) return;
        row.place.setAttribute("x", String(row.x(deg) - 2));
        row.place.setAttribute("class", (arm.near[joint] ?? 0) > NEAR ? "near" : "place");
        row.text.textContent = `${fixed(deg, 1)}°`;
      });
    });
  }
}
