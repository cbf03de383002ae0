// The pawn's own view.

import { clamp, wrap } from "../geometry";
import { DRAG_DEGREES, type Mode, type Stage } from "./mode";

const MOUSE_DEGREES = 0.11;

export class Walk implements Mode {
  readonly name = "walk";
  readonly outside = false;

  constructor(protected readonly stage: Stage) {}

  begin(): void {
    this.stage.cameras.framed = null;
  }

  drag(right: number, down: number): void {
    const { pointer, settings } = this.stage;
    // A captured mouse turns the head; dragging moves the picture.
    const degrees = settings.sensitivity * (pointer.captured ? MOUSE_DEGREES : -DRAG_DEGREES);
    this.turn(right * degrees, -down * degrees);
  }

  zoom(_factor: number): void {
    // A pawn's eyes have no lens.
  }

  turn(right: number, up: number): void {
    const look = this.stage.session?.pawn.look;
    if (look) Object.assign(look, { heading: wrap(look.heading + right), pitch: clamp(look.pitch + up, -89, 89) });
  }
}
