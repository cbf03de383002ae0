// From above, north up, cut below the ceiling.

import type { Mode, Stage } from "./mode";

export class Plan implements Mode {
  readonly name = "plan";
  readonly outside = true;

  constructor(private readonly stage: Stage) {}

  begin(): void {
    const { session, cameras } = this.stage;
    if (session !== null) cameras.around(session.pawn.at, this.name, 0, session.content);
  }

  drag(right: number, down: number): void {
    const high = Math.max(this.stage.canvas.element.clientHeight, 1);
    this.stage.cameras.pan(right / high, -down / high);
  }

  zoom(factor: number): void {
    this.stage.cameras.zoom(factor);
  }

  turn(right: number): void {
    this.stage.cameras.turn(right, 0);
  }
}
