// From outside: around the pawn, or around all of the scan.

import { DRAG_DEGREES, type Mode, type Stage } from "./mode";

export class Orbit implements Mode {
  readonly name = "orbit";
  readonly outside = true;

  constructor(protected readonly stage: Stage) {}

  begin(): void {
    const { session, cameras } = this.stage;
    if (session !== null) cameras.around(session.pawn.at, this.name, session.pawn.look.heading, session.content);
  }

  /** Shows all of the scan. */
  frame(): void {
    const { session, cameras } = this.stage;
    if (session !== null) cameras.frame(session.boxes, session.content);
  }

  drag(right: number, down: number, pan: boolean): void {
    const { cameras, canvas } = this.stage;
    const high = Math.max(canvas.element.clientHeight, 1);
    if (pan) cameras.pan(right / high, -down / high);
    else cameras.turn(right * 2 * DRAG_DEGREES, -down * 2 * DRAG_DEGREES);
  }

  zoom(factor: number): void {
    this.stage.cameras.zoom(factor);
  }

  turn(right: number, up: number): void {
    this.stage.cameras.turn(right, up);
  }
}
