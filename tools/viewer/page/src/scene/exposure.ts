// Exposure of a scan's colours: dark ones, such as intensities of a scanner, are spread over the whole range.

import type { PageColours } from "slicewalk";

/** One colour in so many is counted, and counts are halved so that new pages matter. */
const EVERY = 7;
const MOST = 400_000;
const [LOW, HIGH] = [0.02, 0.98];
/** Brightness that the quantiles are moved to, at most this much brighter. */
const [DARKEST, BRIGHTEST] = [0.04, 0.94];
const MOST_GAIN = 4;
/** Brightness that a darker median is lifted towards. */
const MIDDLE = 0.42;
/** Scans that are brighter than this stay as they are. */
const BRIGHT = 0.72;
const SPREAD = 0.12;

export class Exposure {
  /** Darkest value, what the rest is multiplied with, and how much its middle is lifted. */
  range: readonly [number, number, number] = [0, 1, 0];
  readonly #counts = new Uint32Array(256);
  #sum = 0;

  take({ colours }: PageColours): void {
    for (let at = 0; at < colours.length; at += 4 * EVERY) {
      const value = ((colours[at] ?? 0) * 3 + (colours[at + 1] ?? 0) * 6 + (colours[at + 2] ?? 0)) / 10;
      this.#counts[Math.min(255, Math.round(value))]! += 1;
      this.#sum += 1;
    }
    if (this.#sum > MOST) {
      this.#counts.forEach((count, n) => (this.#counts[n] = count >> 1));
      this.#sum = this.#counts.reduce((sum, count) => sum + count, 0);
    }
    const [low, high] = [this.#quantile(LOW), this.#quantile(HIGH)];
    // Blacks of a bright scan are meant; a narrow or dark range is the scanner's.
    const dark = high < BRIGHT ? 1 : Math.max(0, Math.min(1, (1 - high) / (1 - BRIGHT)));
    const gain = Math.min(MOST_GAIN, (BRIGHTEST - DARKEST) / Math.max(SPREAD, high - low));
    const [wanted, shift] = [1 + dark * (gain - 1), dark * Math.max(0, low - DARKEST / gain)];
    const middle = Math.min(0.95, Math.max(0.05, (this.#quantile(0.5) - shift) * Math.max(1, wanted)));
    const lift = Math.max(0, Math.min(1, (MIDDLE - middle) / (middle * (1 - middle))));
    this.range = this.#sum < 50 ? [0, 1, 0] : [shift, Math.max(1, wanted), lift];
  }

  #quantile(share: number): number {
    let sum = 0;
    const at = this.#counts.findIndex((count) => (sum += count) >= share * this.#sum);
    return Math.max(at, 0) / 255;
  }
}
