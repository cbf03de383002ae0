// The person's pawn: intents become steps of the engine's walker, and the eye follows smoothly.

import type { Vec3, Walker, WalkerInput, WalkerState } from "slicewalk";
import { across, direction, type Look } from "./geometry";
import { moves, type Intent } from "./input/intent";
import type { Obstacle } from "./obstacle";

const RUN_PACE = 2.5;
const FLIGHT_PACE = 4;
/** Longest step of the engine, which drops the rest. */
const LONGEST_STEP_S = 0.25;
/** Delay with which the eye follows stairs. */
const EYE_DELAY_S = 0.07;
/** Distances beyond which, and within which, the eye jumps: it would approach for ever. */
const EYE_JUMP_M = 1;
const EYE_NEAR_M = 1e-4;
const ARRIVED_M = 0.05;
/** Time without progress after which a walk to a place ends. */
const PATIENCE_S = 1;

export type Arrival = "arrived" | "gave-up";

/** A walk to a place: its route; `null` while it is searched, and straight on if there is none. */
interface Walk {
  readonly to: Vec3;
  route: readonly Vec3[] | "straight" | null;
  /** Steps answered before the route was there. */
  since: number;
  readonly search: AbortController;
}

export class Pawn {
  flying = false;
  /** Factor of the walking speed while flying. */
  flightPace = FLIGHT_PACE;
  readonly look: Look = { heading: 0, pitch: 0 };
  onArrival: (how: Arrival) => void = () => {};
  /** Asked for the reason when a walk has no route. */
  onNoRoute: (to: Vec3, signal: AbortSignal) => Promise<Obstacle | null> = async () => null;
  /** What the last walk was blocked by. */
  obstacle: Obstacle | null = null;
  #walk: Walk | null = null;
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

  /** Places to which it goes, from where it is; those of its route that lie behind are left out. */
  get way(): readonly Vec3[] {
    const walk = this.#walk;
    if (walk === null) return [];
    if (walk.route === null || walk.route === "straight") return [this.at, walk.to];
    const begun = this.state.steps > walk.since;
    return [this.at, ...walk.route.slice(begun ? -Math.max(1, this.state.ahead) : 0)];
  }

  /** Walks along a route, in flight straight to the place; without a route to what blocks it, or straight on. */
  async walkTo(place: Vec3): Promise<void> {
    this.stop();
    const search = new AbortController();
    const walk: Walk = { to: place, route: this.flying ? "straight" : null, since: 0, search };
    this.#walk = walk;
    this.#stuck = 0;
    if (walk.route !== null) return;
    const found = await this.walker.route(place, { signal: search.signal }).catch(() => null);
    if (this.#walk !== walk) return;
    // Without an answer, such as for want of memory for its pages, it goes straight on: a pawn never waits for nothing. A closed
    // or failed archive is reported elsewhere.
    if (typeof found !== "string") {
      this.#follow(walk, found === null ? "straight" : found.points);
      return;
    }
    const obstacle = await this.onNoRoute(place, search.signal);
    const near = obstacle && (await this.walker.route(obstacle.at, { signal: search.signal }).catch(() => null));
    if (this.#walk !== walk) return;
    this.obstacle = obstacle;
    this.#follow(walk, near === null || typeof near === "string" ? "straight" : near.points);
  }

  #follow(walk: Walk, route: readonly Vec3[] | "straight"): void {
    walk.route = route;
    walk.since = this.state.steps;
  }

  stop(): void {
    this.#walk?.search.abort();
    this.#walk = null;
    this.obstacle = null;
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
    const apart = Math.abs(at[2] - this.#eyeZ);
    const jumps = ground === "falling" || apart > EYE_JUMP_M || apart < EYE_NEAR_M;
    const share = jumps ? 1 : 1 - Math.exp(-seconds / EYE_DELAY_S);
    this.#eyeZ += (at[2] - this.#eyeZ) * share;
    return [at[0], at[1], this.#eyeZ + (crouched ? Math.min(height, body - 0.1) : height)];
  }

  #input(intent: Intent, heading: number): WalkerInput {
    const walk = this.#walk;
    if (walk?.route === "straight") return { toward: [walk.to[0], walk.to[1]], fly: this.flying };
    if (walk !== null) return { follow: walk.route !== null };
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

  /** Ends a walk at its end, or when the pawn makes no progress. */
  #watch(seconds: number): void {
    const walk = this.#walk;
    if (walk === null || walk.route === null) return;
    const { at, ground, missing, ahead, steps } = this.state;
    if (steps <= walk.since) return;
    this.#stuck = ground === "blocked" && missing === 0 ? this.#stuck + seconds : 0;
    const end = walk.route === "straight" ? walk.to : (walk.route.at(-1) ?? walk.to);
    const near = Math.hypot(at[0] - end[0], at[1] - end[1]) < ARRIVED_M && (walk.route === "straight" || ahead <= 1);
    if (!near && this.#stuck < PATIENCE_S) return;
    const { obstacle } = this;
    this.stop();
    this.obstacle = obstacle;
    this.onArrival(near && obstacle === null ? "arrived" : "gave-up");
  }
}
