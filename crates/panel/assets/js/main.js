// @ts-check
// Puts the parts of the page together.
import "./types.js";
import { Cameras } from "./cameras.js";
import { withCodes } from "./codes.js";
import { Commands } from "./commands.js";
import { Connection, post } from "./connection.js";
import { at, button, canvas, fixed, input, make, write } from "./dom.js";
import { Joints } from "./joints.js";
import { Pace } from "./pace.js";
import { Plots } from "./plots.js";
import { Pointing } from "./pointing.js";
import { Scene } from "./scene.js";
import { askForToken, headers } from "./token.js";
import { showComputing, showPreview, showState } from "./status.js";
import { ImageView, STATUS } from "./view.js";

const LOG_LINES_MAX = 300;
const EPIPOLAR_MS = 80;
const PUSH_MS = 50;
/** A busy computer takes long for a preview; the server itself gives up before. */
const PREVIEW_ANSWER_MS = 11_000;
const NO_TOKEN = 401;
const OVERTAKEN = "PB3DP-PAN-030";
/** Assumed depth of a target that has no pose, mm. */
const DEPTH_MM = 500;

async function info() {
  for (;;) {
    try {
      const response = await fetch("/api/info", { headers: headers() });
      if (response.status === NO_TOKEN) await askForToken(/** @type {HTMLFormElement} */ (at("token")));
      if (response.ok) return /** @type {import("./types.js").Info} */ (await response.json());
    } catch {
      // The program may still start.
    }
    await new Promise((resolve) => setTimeout(resolve, 500));
  }
}

/** Calls at most once per interval, always with the newest arguments. @param {number} interval_ms @param {(...args: number[]) => void} work */
function paced(interval_ms, work) {
  /** @type {number[]|null} */
  let newest = null;
  let waits = false;
  return (/** @type {number[]} */ ...args) => {
    newest = args;
    if (waits) return;
    waits = true;
    setTimeout(() => {
      waits = false;
      if (newest) work(...newest);
    }, interval_ms);
  };
}

const about = await info();
write(at("setup"), `${about.setup} ${about.version}`);
write(at("calibration"), about.cameras.calibration ? `calibration: ${about.cameras.calibration}` : "");
const connection = new Connection();
const commands = new Commands(connection, about);
const left = new ImageView(canvas("left"), about.cameras.size_px);
const right = new ImageView(canvas("right"), about.cameras.size_px);
right.dragMoves = true;
const plots = new Plots();
const cameras = new Cameras(connection, commands, about);
// Targets and rectified images need a calibration.
if (!about.cameras.calibrated) {
  at("target-card").hidden = true;
  for (const id of ["rectified", "epipolar", "heat"]) at(id).parentElement?.toggleAttribute("hidden", true);
}
const joints = new Joints(about.arms);
const scene = about.arms.length > 0 ? new Scene(canvas("scene"), about) : null;
if (!scene) for (const id of ["scene", "joints"]) at(id).parentElement?.toggleAttribute("hidden", true);

/** @type {import("./types.js").State|null} */
let state = null;
/** @type {{region: string, preview: import("./types.js").Preview}|null} */
let marked = null;
/** @type {import("./types.js").Pixel[]} */
let epipolar_px = [];

const pace = new Pace(() => ({ drawn: left.drawn, lost: left.skipped + connection.dropped[0] }), askForImages);
const pointing = new Pointing(left, {
  canPush: about.playground,
  canMark: about.cameras.calibrated,
  onRegion: (region) => void preview(region),
  onCancel: forget,
  onFreeze: (sequence) => [left, right].forEach((view) => view.freeze(sequence)),
  onCursor: showPixel,
  onRaw: () => {
    input("rectified").checked = false;
    askForImages();
    write(at("pixel"), "Regions are marked in the raw images: shown now, mark again.");
  },
  // The server keeps the pair until the region is complete, however long that takes.
  onBegin: () => {
    if (left.image) void post("/api/preview", { sequence: left.image.sequence }, connection.session);
  },
  onPush: paced(PUSH_MS, (du, dv) => {
    const mm = (state?.target.point_mm?.[2] ?? DEPTH_MM) / about.cameras.left.focal_px[0];
    void post("/api/push", { offset_mm: [du * mm, dv * mm, 0], turn_deg: 0 }, connection.session).then((answer) => {
      if (!answer.ok) commands.tell("push", answer);
    });
  }),
});

left.paint = () => {
  const { target } = state ?? { target: null };
  // Outlines are in pixels of the raw images.
  if (left.image?.isRectified) return;
  if (target && !left.isFrozen) {
    const { color, dash } = STATUS[target.status] ?? STATUS.error;
    left.lines(target.outline_px, { color, dash });
    if (target.axes_px) left.axes(target.axes_px);
  }
  if (marked) {
    const { color, dash } = STATUS[marked.preview.status] ?? STATUS.error;
    left.lines(marked.preview.outline_px, { color, dash, width: 3 });
    if (marked.preview.axes_px) left.axes(marked.preview.axes_px);
  }
  pointing.paint();
};
right.paint = () => {
  const { target } = state ?? { target: null };
  if (input("epipolar").checked) right.epipolar(epipolar_px);
  if (right.image?.isRectified) return;
  if (marked) right.lines(marked.preview.outline_right_px, { ...(STATUS[marked.preview.status] ?? STATUS.error), width: 3 });
  else if (target && !right.isFrozen) {
    const { color, dash } = STATUS[target.status] ?? STATUS.error;
    right.lines(target.outline_right_px, { color, dash });
    if (target.axes_right_px) right.axes(target.axes_right_px);
  }
};

connection.onState = (newest) => {
  state = newest;
  showState(newest, pace.text);
  commands.show(newest);
  cameras.show(newest);
  plots.add(newest);
  joints.show(newest.arms);
  scene?.show(newest);
  showSaved(newest.saved);
  button("select").disabled = !commands.leads || marked === null;
  at("select-blocked").hidden = commands.leads;
  left.redraw();
  right.redraw();
};
connection.onImage = (image) => {
  if (image.isHeat) left.overlay(image);
  else (image.side === 0 ? left : right).show(image);
};
connection.onLog = (lines) => {
  const log = at("log");
  const isAtEnd = log.scrollTop + log.clientHeight >= log.scrollHeight - 8;
  for (const { time_ms, level, text, code } of lines) {
    const item = make("li", { class: level });
    const missing = code && !text.includes(code) ? ` [${code}]` : "";
    item.append(make("time", {}, fixed(time_ms / 1000, 2)), ...withCodes(text + missing));
    log.append(item);
  }
  while (log.children.length > LOG_LINES_MAX) log.firstChild?.remove();
  if (isAtEnd) log.scrollTop = log.scrollHeight;
};
connection.onLink = (isOpen) => {
  commands.link(isOpen);
  if (!isOpen) write(at("state"), "no connection");
};

/** @param {string} region @param {number} [tries] */
async function preview(region, tries = 3) {
  const sequence = left.image?.sequence;
  marked = null;
  showComputing();
  const answer = await post("/api/preview", sequence === undefined ? { region } : { region, sequence }, connection.session, PREVIEW_ANSWER_MS);
  if (pointing.region() !== region) return;
  // That of another page may replace this one.
  if (answer.body.code === OVERTAKEN && tries > 1) return preview(region, tries - 1);
  if (!answer.ok) {
    forget();
    commands.tell("preview", answer);
    return;
  }
  marked = { region, preview: answer.body };
  showPreview(answer.body);
  left.redraw();
  right.redraw();
}

function forget() {
  marked = null;
  at("preview").hidden = true;
  left.redraw();
  right.redraw();
}

async function select() {
  if (!marked) return;
  const { region, preview: { sequence } } = marked;
  const name = input("target-name").value.trim() || freeName();
  const body = { region, sequence, seen: commands.seen(), name };
  const answer = await commands.send("/api/select", body, "select");
  if (!answer.ok) return;
  input("target-name").value = "";
  pointing.cancel();
}

/** A name that no saved target has: every target can be chosen again by its name. */
function freeName() {
  for (let number = 1; ; number++) {
    if (!state?.saved.includes(`target ${number}`)) return `target ${number}`;
  }
}

/** @param {string[]} names */
function showSaved(names) {
  const place = at("saved");
  if (place.dataset.names !== names.join("\n")) {
    place.dataset.names = names.join("\n");
    place.replaceChildren(...(names.length ? [make("h3", {}, "saved targets")] : []));
    for (const name of names) {
      const again = make("button", { type: "button" }, name);
      again.addEventListener("click", () => void commands.send("/api/select", { saved: name, seen: commands.seen() }, "select"));
      place.append(again);
    }
  }
  place.querySelectorAll("button").forEach((one) => (one.disabled = !commands.leads));
}

function askForImages() {
  const wanted = !document.hidden;
  connection.ask({ left: wanted, right: wanted, view: input("rectified").checked ? "rectified" : "raw", fps_max: pace.fps_max, heat: input("heat").checked });
  if (!input("heat").checked) left.overlay(null);
}

button("select").addEventListener("click", () => void select());
button("discard").addEventListener("click", () => pointing.cancel());
for (const [id, direction] of /** @type {const} */ ([["nearer", 1], ["farther", -1]])) {
  button(id).addEventListener("click", () => [left, right].forEach((view) => view.zoomStep(direction)));
}
button("unzoom").addEventListener("click", () => [left, right].forEach((view) => view.whole()));
for (const option of ["rectified", "heat"]) input(option).addEventListener("change", askForImages);
document.addEventListener("visibilitychange", askForImages);
const askForLine = paced(EPIPOLAR_MS, async (u, v) => {
  if (!input("epipolar").checked || !about.cameras.calibrated) return;
  if (right.image?.isRectified) {
    // Rows of rectified images are epipolar lines.
    epipolar_px = [[-0.5, v], [about.cameras.size_px[0] - 0.5, v]];
    right.redraw();
    return;
  }
  try {
    const response = await fetch(`/api/epipolar?u=${u.toFixed(1)}&v=${v.toFixed(1)}`, { headers: headers() });
    epipolar_px = response.ok ? (await response.json()).right_px : [];
  } catch {
    epipolar_px = [];
  }
  right.redraw();
});
/** @param {number} u @param {number} v */
function showPixel(u, v) {
  const color = left.colorAt([u, v]);
  const value = color === null ? "" : `: ${new Set(color).size === 1 ? `grey ${color[0]}` : `rgb ${color.join(" ")}`}`;
  write(at("pixel"), `pixel ${fixed(u, 1)}, ${fixed(v, 1)}${value}`);
  askForLine(u, v);
}
canvas("left").addEventListener("pointermove", (event) => showPixel(...left.pixelAt(event)));
canvas("left").addEventListener("pointerleave", () => {
  epipolar_px = [];
  right.redraw();
});
askForImages();
