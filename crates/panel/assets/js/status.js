// @ts-check
// State, reason, target and active conditions in words.
import "./types.js";
import { writeWithCodes } from "./codes.js";
import { at, fixed, make, norm, write } from "./dom.js";
import { STATUS } from "./view.js";

/** Motion in words, by the state of the supervisor. @type {Record<string, string>} */
const MOTION = {
  approaching: "The hand moves to its pose in front of the target.",
  tracking: "The hand follows the target.",
};

/** @param {import("./types.js").State} state @param {string} pace what limits the images, or nothing */
export function showState(state, pace) {
  const pill = at("state");
  write(pill, state.state.name);
  pill.classList.toggle("moving", state.state.is_moving);
  pill.classList.toggle("latched", state.state.is_latched);
  const code = state.why.code && !state.why.line.includes(state.why.code) ? ` [${state.why.code}]` : "";
  const motion = state.why.line === state.state.name ? MOTION[state.state.name] : undefined;
  const line = motion ?? state.why.line + code;
  writeWithCodes(at("why"), line);
  write(at("conditions-title"), state.state.is_moving ? "Motion" : "Why nothing moves");
  writeWithCodes(at("why-long"), line);
  const items = state.why.inhibits.map(({ name, action, since_ms, clears_ms }) => {
    const clears = clears_ms === null ? "" : `, clears in ${fixed(clears_ms / 1000, 1)} s`;
    return `${name} (${action}) for ${fixed(since_ms / 1000, 1)} s${clears}`;
  });
  const list = at("inhibits");
  while (list.children.length > items.length) list.lastChild?.remove();
  items.forEach((text, index) => {
    if (!list.children[index]) list.append(make("li"));
    write(list.children[index], text);
  });
  write(at("trouble"), state.operator.trouble ?? "");
  showTarget(state.target, state.state.name === "idle");
  const { images } = state;
  write(at("images"), `pair ${images.sequence ?? "–"}, ${fixed(images.fps, 1)} per second, ${images.lost} lost; time runs at ${fixed(state.realtime_factor, 2)}${pace}`);
}

/** @param {import("./types.js").TargetState} target @param {boolean} isIdle a target is tracked, but not selected */
function showTarget(target, isIdle) {
  const pill = at("status");
  const { sign } = STATUS[target.status] ?? STATUS.error;
  write(pill, `${sign} ${target.status}`);
  pill.className = `pill status-${target.status}`;
  const name = target.name ? `${target.name}: ` : "";
  const again = isIdle && target.id !== null ? "not selected any more: select it again, or mark another one. " : "";
  write(at("reason"), name + again + target.reason);
  const triple = (/** @type {number[]|null} */ values, /** @type {number} */ decimals) =>
    values ? values.map((value) => fixed(value, decimals)).join(", ") : "–";
  const figures = [
    ["position (x, y, z)", `${triple(target.point_mm, 1)} mm`],
    ["1 sigma, position", `${triple(target.sigma_mm, 3)} mm`],
    ["1 sigma, angles", `${triple(target.sigma_deg, 3)}°`],
    ["since the first pose", `${triple(target.motion_sigma_mm, 3)} mm; ${triple(target.motion_sigma_deg, 3)}°`],
    ["Re-align moves the hand by", target.realign_mm === null ? "–" : `${fixed(target.realign_mm, 1)} mm, ${fixed(target.realign_deg, 2)}°`],
    ["fitness", fixed(target.fitness, 3)],
    ["age, computing", `${fixed(target.age_ms, 0)}, ${fixed(target.latency_ms, 1)} ms`],
  ];
  if (target.error_mm) figures.push(["error (simulated target)", `${fixed(norm(target.error_mm), 2)} mm, ${fixed(norm(target.error_deg), 2)}°`]);
  const list = at("figures");
  while (list.children.length > 2 * figures.length) list.lastChild?.remove();
  figures.forEach(([term, text], index) => {
    if (!list.children[2 * index]) list.append(make("dt"), make("dd"));
    write(list.children[2 * index], term);
    write(list.children[2 * index + 1], text);
  });
}

/** The region is being looked at. */
export function showComputing() {
  at("preview").hidden = false;
  at("preview").classList.add("computing");
  write(at("preview-title"), "computing ...");
  write(at("preview-text"), "");
}

/** @param {import("./types.js").Preview} preview */
export function showPreview(preview) {
  at("preview").hidden = false;
  at("preview").classList.remove("computing");
  at("preview").classList.toggle("will-not", !preview.will_work);
  write(at("select"), preview.will_work ? "Select this target" : "Select it all the same");
  write(at("preview-title"), preview.will_work ? `✓ will work (${preview.status})` : `✗ will not work well (${preview.status})`);
  const depth = preview.depth_mm === null ? "" : `Depth ${fixed(preview.depth_mm, 1)} mm`;
  const sigma = preview.sigma_mm ? ` ± ${fixed(preview.sigma_mm[2], 2)} mm (1 sigma)` : "";
  const tilt = preview.sigma_deg ? `, tilt ± ${fixed(Math.max(preview.sigma_deg[0], preview.sigma_deg[1]), 2)}°` : "";
  write(at("preview-text"), [preview.why, depth + sigma + tilt, `${fixed(preview.ms, 0)} ms`].filter(Boolean).join(" · "));
}
