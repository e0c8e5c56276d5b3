// @ts-check
// How many images per second the page asks for: no more than it can draw.

const FPS_MAX = 30;
const FPS_MIN = 2;
const PERIOD_MS = 2000;
/** Above this share of images that were not drawn the page asks for fewer. */
const LOST_SHARE_MAX = 0.2;
/** Below this share it asks for more again. */
const LOST_SHARE_GOOD = 0.03;
const MORE = 1.25;

export class Pace {
  /**
   * @param {() => {drawn: number, lost: number}} count images of one camera since the page began
   * @param {() => void} changed
   */
  constructor(count, changed) {
    this.fps_max = FPS_MAX;
    /** The first period is the start of the page. @type {{drawn: number, lost: number}|null} */
    let before = null;
    setInterval(() => {
      const now = count();
      const { drawn, lost } = before ? { drawn: now.drawn - before.drawn, lost: now.lost - before.lost } : { drawn: 0, lost: 0 };
      before = now;
      if (document.hidden || drawn + lost === 0) return;
      const fps_max = this.next(drawn, lost);
      if (fps_max === this.fps_max) return;
      this.fps_max = fps_max;
      changed();
    }, PERIOD_MS);
  }

  /** @param {number} drawn @param {number} lost */
  next(drawn, lost) {
    const share = lost / (drawn + lost);
    if (share > LOST_SHARE_MAX) return Math.max(FPS_MIN, Math.min(this.fps_max - 1, Math.floor((drawn * 1000) / PERIOD_MS)));
    if (share < LOST_SHARE_GOOD) return Math.min(FPS_MAX, Math.ceil(this.fps_max * MORE));
    return this.fps_max;
  }

  /** What the operator should know, or nothing. */
  get text() {
    return this.fps_max < FPS_MAX ? `; at most ${this.fps_max} images per second: this browser is slow` : "";
  }
}
