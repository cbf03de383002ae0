// A map of the storey around the pawn, north up, with its place and heading.

import type { Archive, SliceMap, Vec3 } from "slicewalk";
import { distance, wrap } from "../geometry";
import { texts } from "../texts.en";
import { h } from "./dom";

const EDGE_M = 24;
const CELLS = 192;
const SIZE_PX = 176;
/** Distance after which the map is redrawn, and the interval while pages arrive. */
const WAY_M = 0.7;
const OFTEN_MS = 1200;
/** Range of the storey relative to the feet: from floors below steps up to the head. */
const BELOW_M = 0.6;
const ABOVE_M = 1.8;
/** Red, green, blue and opacity of empty, floor, obstacle and not loaded. */
const COLOURS = new Uint32Array(Uint8Array.from([0, 0, 0, 0, 84, 97, 112, 255, 226, 230, 235, 255, 0, 0, 0, 70]).buffer);

/** Drawn by the processor, because a slow graphics queue would block the main thread. */
const IN_MEMORY: CanvasRenderingContext2DSettings = { willReadFrequently: true };

export class Minimap {
  readonly element = h("div", { class: "panel minimap" });
  readonly #canvas = h("canvas", { width: SIZE_PX * 2, height: SIZE_PX * 2, role: "img" });
  readonly #picture = h("canvas");
  #map: SliceMap | null = null;
  #at: Vec3 | null = null;
  #asked = 0;
  #busy = false;
  #loaded = -1;
  #drawn: { map: SliceMap | null; at: Vec3; heading: number } | null = null;

  constructor(readonly archive: Archive) {
    this.element.append(this.#canvas);
    this.#name(0);
  }

  update(at: Vec3, heading: number): void {
    const now = performance.now();
    const news = this.archive.stats.loaded !== this.#loaded && now - this.#asked > OFTEN_MS;
    if (!this.#busy && (this.#at === null || distance(at, this.#at) > WAY_M || news)) void this.#ask(at, now);
    this.#draw(at, heading);
  }

  async #ask(at: Vec3, now: number): Promise<void> {
    [this.#busy, this.#at, this.#asked, this.#loaded] = [true, at, now, this.archive.stats.loaded];
    const half = EDGE_M / 2 + WAY_M;
    const area = { min: [at[0] - half, at[1] - half], max: [at[0] + half, at[1] + half] } as const;
    try {
      this.#map = await this.archive.map(area, [at[2] - BELOW_M, at[2] + ABOVE_M], CELLS);
      this.#paint(this.#map);
    } catch {
      // A closed or failed archive is reported elsewhere.
    } finally {
      this.#busy = false;
    }
  }

  #paint({ width, height, cells }: SliceMap): void {
    if (this.#picture.width !== width || this.#picture.height !== height) Object.assign(this.#picture, { width, height });
    const context = this.#picture.getContext("2d", IN_MEMORY);
    if (context === null || cells.length === 0) return;
    const image = context.createImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer);
    for (let n = 0; n < pixels.length; n++) pixels[n] = COLOURS[cells[n] ?? 0] ?? 0;
    context.putImageData(image, 0, 0);
  }

  #draw(at: Vec3, heading: number): void {
    const context = this.#canvas.getContext("2d", IN_MEMORY);
    const map = this.#map;
    const drawn = this.#drawn;
    if (context === null || (drawn?.map === map && drawn.heading === heading && distance(drawn.at, at) === 0)) return;
    this.#drawn = { map, at, heading };
    const size = this.#canvas.width;
    const scale = size / EDGE_M;
    context.clearRect(0, 0, size, size);
    if (map !== null && map.width > 0) {
      context.imageSmoothingEnabled = false;
      const [left, bottom] = [(map.min[0] - at[0]) * scale + size / 2, size / 2 - (map.min[1] - at[1]) * scale];
      const [wide, high] = [map.width * map.cell * scale, map.height * map.cell * scale];
      context.drawImage(this.#picture, left, bottom - high, wide, high);
    }
    context.save();
    context.translate(size / 2, size / 2);
    context.rotate((heading * Math.PI) / 180);
    context.fillStyle = "rgba(255, 181, 71, 0.18)";
    context.beginPath();
    context.moveTo(0, 0);
    context.arc(0, 0, 70, -Math.PI / 2 - 0.6, -Math.PI / 2 + 0.6);
    context.fill();
    context.fillStyle = "#ffb547";
    context.beginPath();
    context.moveTo(0, -15);
    context.lineTo(10, 11);
    context.lineTo(0, 6);
    context.lineTo(-10, 11);
    context.fill();
    context.restore();
    this.#name(heading);
  }

  #name(heading: number): void {
    const cardinal = texts.minimap.cardinal[Math.round(wrap(heading) / 45) % 8] ?? "";
    this.#canvas.setAttribute("aria-label", texts.minimap.label(cardinal));
  }
}
