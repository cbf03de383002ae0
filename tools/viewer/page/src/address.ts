// The page's address holds the archive, the place and the view: ?archive=URL&at=X,Y,Z&look=HEADING,PITCH&view=plan, and
// Gaussian splats to draw over the archive: &splats=URL&align=X,Y,Z,TURN,SCALE&up=z
// Other fields say how the page is, such as its language, and stay in it.

import type { Vec3 } from "slicewalk";
import { clamp, wrap, type Look } from "./geometry";
import { ALIGNED, isUp, type Alignment } from "./scene/alignment";

export type Mode = "walk" | "orbit" | "plan";

export interface Place {
  archive: string | null;
  at: Vec3 | null;
  look: Look | null;
  /** Null: the address does not say. */
  mode: Mode | null;
  splats: { readonly url: string; readonly alignment: Alignment } | null;
}

function numbers(text: string | null, count: number): number[] | null {
  const parts = text?.split(",").map((part) => (part.trim() === "" ? NaN : Number(part))) ?? [];
  return parts.length === count && parts.every(Number.isFinite) ? parts : null;
}

export function parseAddress(search: string): Place {
  const fields = new URLSearchParams(search);
  const at = numbers(fields.get("at"), 3);
  const look = numbers(fields.get("look"), 2);
  const view = fields.get("view");
  const splats = fields.get("splats") || null;
  return {
    archive: fields.get("archive") || null,
    at: at as Vec3 | null,
    look: look && { heading: wrap(look[0] ?? 0), pitch: clamp(look[1] ?? 0, -89, 89) },
    mode: view === "orbit" || view === "plan" || view === "walk" ? view : null,
    splats: splats === null ? null : { url: splats, alignment: alignment(fields) },
  };
}

function alignment(fields: URLSearchParams): Alignment {
  const [x = 0, y = 0, z = 0, turn = ALIGNED.turn, scale = ALIGNED.scale] = numbers(fields.get("align"), 5) ?? [];
  const up = fields.get("up");
  return { at: [x, y, z], turn, scale: scale > 0 ? scale : ALIGNED.scale, up: isUp(up) ? up : ALIGNED.up };
}

/** Fields that say how the page is. */
const KEPT = ["lang", "kiosk", "tour", "settings"] as const;

/**
 * Rounds to millimetres and hundredths of a degree; heights are rounded up so that the feet stay above the floor. Keeps the fields
 * of `search` that say how the page is.
 */
export function formatAddress({ archive, at, look, mode, splats }: Place, search: string = location.search): string {
  const round = (value: number, digits: number): string => String(Number(value.toFixed(digits)));
  const url = (text: string): string => encodeURIComponent(text).replaceAll("%2F", "/").replaceAll("%3A", ":");
  const fields: string[] = [];
  if (archive !== null) fields.push(`archive=${url(archive)}`);
  if (at !== null) fields.push(`at=${[round(at[0], 3), round(at[1], 3), round(Math.ceil(at[2] * 1000) / 1000, 3)].join(",")}`);
  if (look !== null) fields.push(`look=${round(look.heading, 2)},${round(look.pitch, 2)}`);
  if (mode !== null && mode !== "walk") fields.push(`view=${mode}`);
  if (splats !== null) {
    const { at: origin, turn, scale, up } = splats.alignment;
    fields.push(`splats=${url(splats.url)}`, `align=${[...origin, turn, scale].join(",")}`, `up=${up}`);
  }
  const before = new URLSearchParams(search);
  for (const name of KEPT) {
    const value = before.get(name);
    if (value !== null) fields.push(`${name}=${url(value)}`);
  }
  return `?${fields.join("&")}`;
}
