// Files of Gaussian splats, and how they lie in a scan: they name no coordinate system.

import type { Vec3 } from "slicewalk";

/** Which axis of the splats points up; y down is what most training programs write. */
export const UPS = ["z", "y", "-y"] as const;
export type Up = (typeof UPS)[number];

export interface Alignment {
  /** Where their origin lies (m, coordinates of the scan). */
  readonly at: Vec3;
  /** Turn about the vertical: degrees, clockwise seen from above. */
  readonly turn: number;
  /** Metres in one of their units. */
  readonly scale: number;
  readonly up: Up;
}

/** They have the scan's own coordinates. */
export const ALIGNED: Alignment = { at: [0, 0, 0], turn: 0, scale: 1, up: "z" };

export const isUp = (text: string | null): text is Up => UPS.some((up) => up === text);

/** Whether a file of this name holds splats. */
export const namesSplats = (name: string): boolean => /\.(ply|splat|ksplat|spz|sog)$/i.test(name);
