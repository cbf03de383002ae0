// Files of Gaussian splats and their placement in a scan; the files state no coordinate system.

import type { Vec3 } from "slicewalk";

/** Axis of the splats that points up; most training programs write y down. */
export const UPS = ["z", "y", "-y"] as const;
export type Up = (typeof UPS)[number];

export interface Alignment {
  /** Position of their origin (m, coordinates of the scan). */
  readonly at: Vec3;
  /** Rotation about the vertical: degrees, clockwise seen from above. */
  readonly turn: number;
  /** Metres per unit of the splats. */
  readonly scale: number;
  readonly up: Up;
}

/** Placement of splats in the scan's own coordinates. */
export const ALIGNED: Alignment = { at: [0, 0, 0], turn: 0, scale: 1, up: "z" };

export const isUp = (text: string | null): text is Up => UPS.some((up) => up === text);

/** First bytes of a PLY among which its header names what it holds. */
const HEAD_BYTES = 16384;

/** Whether a file holds splats: by its name, and a PLY by its header, as there are scans and models of this name. */
export async function isSplats(file: File): Promise<boolean> {
  if (!/\.ply$/i.test(file.name)) return /\.(splat|ksplat|spz|sog)$/i.test(file.name);
  const [head = ""] = (await file.slice(0, HEAD_BYTES).text()).split("end_header");
  return /\s(packed_position|rot_0|f_dc_0)\s/.test(head);
}
