// What the ways to look have in common: how they answer the pointer and the keys that turn.

import type { Mode as Name } from "../address";
import type { Canvas } from "../canvas";
import type { Pointer } from "../input/pointer";
import type { Cameras } from "../scene/cameras";
import type { Session } from "../session";
import type { Settings } from "../settings";
import type { Sight } from "../sight";
import type { Shell } from "../ui/shell";

/** What modes work with. */
export interface Stage {
  readonly shell: Shell;
  readonly canvas: Canvas;
  readonly cameras: Cameras;
  readonly pointer: Pointer;
  readonly settings: Settings;
  readonly session: Session | null;
  readonly sight: Sight | null;
}

export interface Mode {
  readonly name: Name;
  /** Whether the pawn is seen from outside. */
  readonly outside: boolean;
  /** Called when the mode begins. */
  begin(): void;
  /** Dragged, in CSS pixels; `pan`: with the right button or shift. */
  drag(right: number, down: number, pan: boolean): void;
  /** The wheel, or two fingers. */
  zoom(factor: number): void;
  /** Keys and sticks, in degrees. */
  turn(right: number, up: number): void;
}

export const DRAG_DEGREES = 0.16;
