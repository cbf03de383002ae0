// A map of the storey around the pawn, north up, with its place and heading; a click goes there.

import type { Archive, SliceMap, Vec3 } from "slicewalk";
import { distance, metres, wrap } from "../geometry";
import { texts } from "../languages";
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
/** Length of the scale bar. */
const BAR_M = 5;
/** Storeys are looked for at places this far apart in a square around the pawn, and this far up and down. */
const STOREY_STEP_M = 2;
const STOREY_PLACES = 5;
const STOREY_REACH_M = 20;
/** Floors closer than this are one storey, which must be under so many places. */
const STOREY_M = 1.6;
const STOREY_SHARE = 0.25;
const MOST_STOREYS = 6;
/** Headroom of a storey. */
const ROOM_M = 1.6;
/** Red, green, blue and opacity of empty, floor, obstacle and not loaded. */
const COLOURS = new Uint32Array(Uint8Array.from([0, 0, 0, 0, 84, 97, 112, 255, 226, 230, 235, 255, 0, 0, 0, 70]).buffer);

/** Drawn by the processor, because a slow graphics queue would block the main thread. */
const IN_MEMORY: CanvasRenderingContext2DSettings = { willReadFrequently: true };

export class Minimap {
  readonly element = h("div", { class: "minimap" });
  readonly #canvas = h("canvas", { width: SIZE_PX * 2, height: SIZE_PX * 2, role: "img" });
  readonly #storeys = h("div", { class: "storeys", role: "group", "aria-label": texts.minimap.storeys, hidden: true });
  readonly #picture = h("canvas");
  #map: SliceMap | null = null;
  #at: Vec3 | null = null;
  #asked = 0;
  #busy = false;
  #loaded = -1;
  #drawn: { map: SliceMap | null; at: Vec3; heading: number } | null = null;

  /** `go` receives places that were clicked, `climb` those on another storey. */
  constructor(
    readonly archive: Archive,
    readonly go: (place: readonly [number, number]) => void,
    readonly climb: (place: Vec3) => void,
  ) {
    const legend = h("div", { class: "map-legend", "aria-hidden": "true" }, h("span", { class: "north" }, texts.minimap.north));
    const bar = h("span", { class: "scale-bar" }, `${BAR_M} m`);
    bar.style.width = `${(100 * BAR_M) / EDGE_M}%`;
    legend.append(bar);
    this.element.append(this.#storeys, h("div", { class: "panel map" }, this.#canvas, legend));
    this.#canvas.addEventListener("click", ({ offsetX, offsetY }) => {
      const at = this.#drawn?.at;
      const scale = EDGE_M / this.#canvas.clientWidth;
      const half = EDGE_M / 2;
      if (at) this.go([at[0] + offsetX * scale - half, at[1] + half - offsetY * scale]);
    });
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
      await this.#findStoreys(at);
    } catch {
      // A closed or failed archive is reported elsewhere.
    } finally {
      this.#busy = false;
    }
  }

  /** Offers the storeys around a place, by floors with headroom in what is loaded. */
  async #findStoreys(at: Vec3): Promise<void> {
    const half = this.archive.info.pixelSize / 2;
    const places: Vec3[] = [];
    for (let n = 0; n < STOREY_PLACES ** 2; n++) {
      const [x, y] = [n % STOREY_PLACES, Math.floor(n / STOREY_PLACES)].map(
        (k) => (k - (STOREY_PLACES - 1) / 2) * STOREY_STEP_M,
      );
      for (let z = -STOREY_REACH_M; z <= STOREY_REACH_M; z += STOREY_M)
        places.push([at[0] + (x ?? 0), at[1] + (y ?? 0), at[2] + z]);
    }
    const box = ([x, y, z]: Vec3, low: number, high: number): number[] => [
      x - half,
      y - half,
      z + low,
      x + half,
      y + half,
      z + high,
    ];
    const found = await this.archive.floor(new Float64Array(places.flatMap((place) => box(place, -STOREY_M, 0))));
    const floors = places.map(([x, y], n): Vec3 => [x, y, found[n] ?? NaN]).filter(([, , z]) => Number.isFinite(z));
    const free = await this.archive.overlaps(new Float64Array(floors.flatMap((floor) => box(floor, 0.1, ROOM_M))));
    const rooms = floors.filter((_, n) => free[n] === 0).sort((a, b) => a[2] - b[2]);
    const storeys: Vec3[][] = [];
    for (const room of rooms) {
      const last = storeys.at(-1);
      if (last !== undefined && room[2] - (last.at(-1)?.[2] ?? 0) < STOREY_M / 2) last.push(room);
      else storeys.push([room]);
    }
    const spread = (rooms: Vec3[]): number => new Set(rooms.map(([x, y]) => `${x} ${y}`)).size;
    const solid = storeys.filter((storey) => spread(storey) >= STOREY_SHARE * STOREY_PLACES ** 2).slice(0, MOST_STOREYS);
    this.#storeys.hidden = solid.length < 2;
    const buttons = solid.toReversed().map((storey) => {
      const nearest = storey.reduce((best, place) => (distance(place, at) < distance(best, at) ? place : best));
      const here = Math.abs(nearest[2] - at[2]) < STOREY_M / 2;
      const label = texts.minimap.storey(metres(nearest[2], 1));
      const climb = (): void => this.climb(nearest);
      return h("button", { type: "button", class: "tool", "aria-pressed": here ? "true" : "false", onclick: climb }, label);
    });
    const [before, after] = [this.#storeys, { children: buttons }].map(({ children }) =>
      [...children].map((b) => b.outerHTML).join(),
    );
    if (before !== after) this.#storeys.replaceChildren(...buttons);
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
