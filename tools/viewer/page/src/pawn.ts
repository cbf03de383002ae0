// The person's pawn: intents become steps of the engine's walker, and the eye follows smoothly.

import type { Vec3, Walker, WalkerInput, WalkerState } from "slicewalk";
import { across, direction, type Look } from "./geometry";
import { moves, type Intent } from "./input/intent";

const RUN_PACE = 2.5;
const FLIGHT_PACE = 4;
/** Longest step of the engine, which drops the rest. */
const LONGEST_STEP_S = 0.25;
/** Delay with which the eye follows stairs. */
const EYE_DELAY_S = 0.07;
/** Distance beyond which the eye jumps. */
const EYE_JUMP_M = 1;
const ARRIVED_M = 0.05;
/** Time without progress after which a walk to a place ends. */
const PATIENCE_S = 1;

export type Arrival = "arrived" | "gave-up";

export class Pawn {
  flying = false;
  /** Factor of the walking speed while flying. */
  flightPace = FLIGHT_PACE;
  readonly look: Look = { heading: 0, pitch: 0 };
  onArrival: (how: Arrival) => void = () => {};
  #target: Vec3 | null = null;
  #stuck = 0;
  #time = 0;
  #busy = false;
  #jump = false;
  #eyeZ: number;

  constructor(readonly walker: Walker) {
    this.#eyeZ = walker.state.at[2];
  }

  get state(): WalkerState {
    return this.walker.state;
  }

  get at(): Vec3 {
    return this.state.at;
  }

  get target(): Vec3 | null {
    return this.#target;
  }

  walkTo(place: Vec3): void {
    this.#target = place;
    this.#stuck = 0;
  }

  stop(): void {
    this.#target = null;
  }

  async place(at: Vec3): Promise<void> {
    this.stop();
    await this.walker.place(at);
    this.#eyeZ = at[2];
  }

  /** Lets time pass. At most one step is in flight; meanwhile time accumulates. */
  step(seconds: number, intent: Intent, heading: number): void {
    this.#time = Math.min(this.#time + seconds, LONGEST_STEP_S);
    this.#jump ||= intent.jump;
    if (moves(intent)) this.stop();
    if (this.#busy || this.#time === 0) return;
    const time = this.#time;
    const input = this.#input(intent, heading);
    this.#time = 0;
    this.#jump = false;
    this.#busy = true;
    // A closed or failed archive is reported elsewhere.
    const done = (): void => void (this.#busy = false);
    this.walker.step(time, input).then(done, done);
    this.#watch(time);
  }

  /** Height of the eye, smoothed over steps. */
  eye(height: number, seconds: number): Vec3 {
    const { at, crouched, height: body, ground } = this.state;
    const far = Math.abs(at[2] - this.#eyeZ) > EYE_JUMP_M;
    const share = ground === "falling" || far ? 1 : 1 - Math.exp(-seconds / EYE_DELAY_S);
    this.#eyeZ += (at[2] - this.#eyeZ) * share;
    return [at[0], at[1], this.#eyeZ + (crouched ? Math.min(height, body - 0.1) : height)];
  }

  #input(intent: Intent, heading: number): WalkerInput {
    if (this.#target !== null) return { toward: [this.#target[0], this.#target[1]] };
    const { forward, right } = across(heading);
    const along = this.flying ? direction({ heading, pitch: this.look.pitch }) : [...forward, 0];
    const wish = [0, 1].map((axis) => intent.forward * (along[axis] ?? 0) + intent.right * (right[axis] ?? 0));
    const lift = intent.lift + intent.forward * (along[2] ?? 0);
    return {
      wish: [wish[0] ?? 0, wish[1] ?? 0],
      pace: Math.min(100, (this.flying ? this.flightPace : 1) * (intent.run ? RUN_PACE : 1)),
      jump: this.#jump && !this.flying,
      crouch: intent.crouch && !this.flying,
      fly: this.flying,
      lift: this.flying ? Math.max(-1, Math.min(1, lift)) : 0,
    };
  }

  /** Ends a walk at its target, or when the pawn makes no progress. */
  #watch(seconds: number): void {
    if (this.#target === null) return;
    const { at, ground, missing } = this.state;
    this.#stuck = ground === "blocked" && missing === 0 ? this.#stuck + seconds : 0;
    const near = Math.hypot(at[0] - this.#target[0], at[1] - this.#target[1]) < ARRIVED_M;
    if (!near && this.#stuck < PATIENCE_S) return;
    this.stop();
    this.onArrival(near ? "arrived" : "gave-up");
  }
}
