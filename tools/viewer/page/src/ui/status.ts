// The status panel: where the pawn is, what it does, and what has been loaded.

import type { Stats, WalkerState } from "slicewalk";
import { bytes, metres, thousands } from "../geometry";
import { texts } from "../languages";
import { h, write } from "./dom";

const ROWS = [
  "position",
  "crs",
  "ground",
  "speed",
  "frames",
  "pages",
  "loaded",
  "colours",
  "missing",
  "cache",
  "drawn",
] as const;

type Row = (typeof ROWS)[number];

export interface Facts {
  readonly state: WalkerState;
  readonly stats: Stats;
  readonly crs: string;
  readonly fps: number;
  readonly triangles: number;
}

/** The EPSG code of a WKT itself, not of its datum or units: a child right below the outermost brackets. */
function ownCode(crs: string): string | undefined {
  let depth = 0;
  for (const { index, 0: found } of crs.matchAll(/"[^"]*"|[[\]]/g)) {
    if (found === "[") depth++;
    else if (found === "]") depth--;
    else if (depth === 2 && found === '"EPSG"' && /(?:AUTHORITY|ID)\s*\[\s*$/.test(crs.slice(0, index))) {
      return /^\s*,\s*"?(\d+)/.exec(crs.slice(index + found.length))?.[1];
    }
  }
  return undefined;
}

/** The name in a WKT, or the text itself. */
export function crsName(crs: string): string {
  const name = /^\s*\w+\s*\[\s*"([^"]+)"/.exec(crs)?.[1] ?? crs.trim();
  const code = ownCode(crs);
  return code === undefined || name.includes(code) ? name : `${name} (EPSG:${code})`;
}

export class StatusPanel {
  readonly element: HTMLDetailsElement;
  readonly #values = new Map<Row, HTMLElement>();
  readonly #place = h("span", { class: "place" }, texts.panel.label);

  constructor() {
    const list = h("dl");
    for (const row of ROWS) {
      const value = h("dd");
      this.#values.set(row, value);
      list.append(h("div", { class: row }, h("dt", {}, texts.panel[row]), value));
    }
    this.element = h(
      "details",
      { class: "panel status", "aria-label": texts.panel.label },
      h("summary", {}, this.#place),
      list,
    );
  }

  update({ state, stats, crs, fps, triangles }: Facts): void {
    const { panel } = texts;
    const place = state.at.map((value) => metres(value)).join("  ");
    const stop = state.stop !== null && state.ground !== "flying" ? `, ${panel.stopped(state.stop)}` : "";
    const ground = `${panel.states[state.ground]}${stop}`;
    const name = crs === "" ? "" : ` · ${crs}`;
    write(this.#place, `${place}${name} · ${panel.states[state.ground]}`);
    const rows: Record<Row, string> = {
      position: place,
      crs: crs === "" ? panel.unknownCrs : crs,
      ground,
      speed: `${metres(state.speed, 1)} m/s`,
      frames: panel.fps(Math.round(fps)),
      pages: panel.pagesOf(stats.pages.resident, bytes(stats.pages.bytes)),
      loaded: panel.loadedOf(bytes(stats.bytesLoaded), stats.requests),
      colours: stats.colours.requests > 0 ? panel.coloursOf(bytes(stats.colours.bytes), stats.colours.requests) : panel.none,
      missing: String(state.missing),
      cache: panel.cacheOf(bytes(stats.usedBytes), bytes(stats.budgetBytes)),
      drawn: panel.drawnOf(thousands(triangles)),
    };
    ROWS.forEach((row) => write(this.#values.get(row) as HTMLElement, rows[row]));
    this.#values.get("crs")?.setAttribute("title", rows.crs);
  }
}
