// Flight: the pawn's view, without gravity; the wheel sets the speed.

import { clamp, metres } from "../geometry";
import { texts } from "../languages";
import { Walk } from "./walk";

const [SLOWEST, FASTEST] = [0.5, 60];

export class Fly extends Walk {
  override zoom(factor: number): void {
    const { session, settings, shell } = this.stage;
    if (session === null) return;
    const { pawn } = session;
    pawn.flightPace = clamp(pawn.flightPace / factor, SLOWEST, FASTEST);
    shell.messages.say(texts.news.flightSpeed(metres(settings.speed * pawn.flightPace, 1)));
  }
}
