// The page's address carries the archive, the place and the view: ?archive=URL&at=X,Y,Z&look=HEADING,PITCH&view=plan

import type { Vec3 } from "slicewalk";
import type { Look } from "./geometry";

export type Mode = "walk" | "orbit" | "plan";

export interface Place {
  archive: string | null;
  at: Vec3 | null;
  look: Look | null;
  mode: Mode;
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
  return {
    archive: fields.get("archive") || null,
    at: at as Vec3 | null,
    look: look && { heading: look[0] ?? 0, pitch: look[1] ?? 0 },
    mode: view === "orbit" || view === "plan" ? view : "walk",
  };
}

/** Millimetres, heights rounded up so that feet stay above the floor, and hundredths of a degree. */
export function formatAddress({ archive, at, look, mode }: Place): string {
  const round = (value: number, digits: number): string => String(Number(value.toFixed(digits)));
  const fields: string[] = [];
  if (archive !== null) fields.push(`archive=${encodeURIComponent(archive).replaceAll("%2F", "/").replaceAll("%3A", ":")}`);
  if (at !== null) fields.push(`at=${[round(at[0], 3), round(at[1], 3), round(Math.ceil(at[2] * 1000) / 1000, 3)].join(",")}`);
  if (look !== null) fields.push(`look=${round(look.heading, 2)},${round(look.pitch, 2)}`);
  if (mode !== "walk") fields.push(`view=${mode}`);
  return `?${fields.join("&")}`;
}
