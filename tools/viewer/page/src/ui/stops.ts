// Why the pawn does not get on, at the crosshair, with what helps.

import type { Stop } from "slicewalk";
import type { Pawn } from "../pawn";
import { texts } from "../languages";
import { h, write } from "./dom";

export interface Remedies {
  crouch(): void;
  smaller(): void;
  fly(): void;
}

/** What helps against each reason. */
const REMEDY: Record<Stop, keyof Remedies | null> = {
  wall: null,
  steep: "fly",
  headroom: "crouch",
  corner: "smaller",
  inside: "fly",
  ledge: "fly",
  void: "fly",
};
/** The pawn must be stopped for so long (s); the words stay for so long after. */
const AFTER_S = 0.35;
const STAYS_S = 3;

export class Stops {
  readonly #words = h("span");
  readonly #button: HTMLButtonElement;
  #reason: Stop | null = null;
  #since = 0;
  #left = 0;

  constructor(
    readonly element: HTMLElement,
    remedies: Remedies,
  ) {
    const help = (): void => {
      const remedy = this.#reason && REMEDY[this.#reason];
      if (remedy !== null) remedies[remedy]();
      this.element.hidden = true;
    };
    this.#button = h("button", { type: "button", class: "plain", onclick: help });
    element.append(this.#words, this.#button);
  }

  update({ state, flying }: Pawn, seconds: number): void {
    const { stop, ground, missing } = state;
    const stuck = ground === "blocked" && missing === 0 && !flying && stop !== null;
    this.#since = stuck ? this.#since + seconds : 0;
    if (stuck && this.#since >= AFTER_S) {
      this.#left = STAYS_S;
      if (this.#reason !== stop || this.element.hidden) this.#say(stop, state.crouched);
    } else if (!stuck && !this.element.hidden) {
      this.#left -= ground === "walking" && state.speed > 0.3 ? STAYS_S : seconds;
      if (this.#left <= 0) this.element.hidden = true;
    }
  }

  #say(stop: Stop, crouched: boolean): void {
    this.#reason = stop;
    write(this.#words, texts.stops[stop]);
    const remedy = REMEDY[stop];
    this.#button.hidden = remedy === null || (remedy === "crouch" && crouched);
    if (remedy !== null) write(this.#button, texts.remedies[remedy]);
    this.element.hidden = false;
  }
}
