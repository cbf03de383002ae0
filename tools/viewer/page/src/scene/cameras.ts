// Three views: from the pawn's eyes, orbiting it, and from above.

import type { Bounds, Vec3 } from "slicewalk";
import { OrthographicCamera, PerspectiveCamera, Vector3, type Camera } from "three";
import { type Mode } from "../address";
import { across, add, clamp, direction, wrap, type Look, type Ray } from "../geometry";
import { frame, type Frame } from "./framing";
import type { World } from "./world";

const UP = new Vector3(0, 0, 1);
const RADIANS = Math.PI / 180;
/** Widest field of view of a narrow screen. */
const WIDEST = 100;
/** Distance from which a pawn is looked at. */
const AROUND_M = 18;
/** Height of the part of a storey that a plan shows. */
const PLAN_M = 40;

export class Cameras {
  readonly #eye = new PerspectiveCamera(70, 1, 0.04, 12_000);
  readonly #top = new OrthographicCamera(-1, 1, 1, -1, 0.1, 8000);
  /** Orbit and plan: target, distance and direction. */
  readonly orbit = { target: [0, 0, 0] as Vec3, distance: AROUND_M, look: { heading: 30, pitch: -40 } as Look };
  /** Field of view from top to bottom (degrees). */
  field = 70;
  /** The frame that shows all of the scan, while it is shown so. */
  framed: Frame | null = null;
  #aspect = 1;
  #mode: Mode = "walk";
  #position: Vec3 = [0, 0, 0];
  #forward: Vec3 = [0, 1, 0];

  get current(): Camera {
    return this.#mode === "plan" ? this.#top : this.#eye;
  }

  get position(): Vec3 {
    return this.#position;
  }

  /** Position from which a person would see as much; a plan is drawn from farther above. */
  get stand(): Vec3 {
    return add(this.orbit.target, this.#forward, -this.orbit.distance);
  }

  resize(width: number, height: number): void {
    this.#aspect = width / Math.max(height, 1);
  }

  /** Field of view from top to bottom; a narrow screen shows as wide a view as a square one. */
  get #field(): number {
    const narrow = (2 / RADIANS) * Math.atan(Math.tan((this.field / 2) * RADIANS) / this.#aspect);
    return this.#aspect < 1 ? Math.max(this.field, Math.min(WIDEST, narrow)) : this.field;
  }

  /** Pixels of a picture of this height for a length of 1 at a distance of 1; in a plan, at that of `stand`. */
  focal(height: number): number {
    return this.#mode === "plan" ? height : height / (2 * Math.tan((this.#field / 2) * RADIANS));
  }

  /** Shows all of a scan with these pages. */
  frame(boxes: Float64Array, bounds: Bounds): void {
    const tan = Math.tan((this.#field / 2) * RADIANS);
    this.framed = frame(boxes, bounds, tan * this.#aspect, tan);
    Object.assign(this.orbit, { ...this.framed, look: { ...this.framed.look } });
  }

  /** Looks at the scan from this share of the frame's distance; what is worth approaching stays where it is in the picture. */
  approach(share: number): void {
    if (this.framed === null) return;
    const { focus, target, distance } = this.framed;
    this.orbit.target = add(focus, add(target, focus, -1), share);
    this.orbit.distance = share * distance;
  }

  /** Turns back and forth around the frame, by `share` of its range from -1 to 1. */
  sway(degrees: number): void {
    if (this.framed !== null) this.orbit.look.heading = wrap(this.framed.look.heading + degrees);
  }

  /** Looks at a pawn, from no farther than all of the scan needs. */
  around(at: Vec3, mode: Mode, heading: number, { min, max }: Bounds): void {
    const [wide, long] = [max[0] - min[0], max[1] - min[1]];
    const isPlan = mode === "plan";
    // A storey that fits into the plan is shown whole.
    const whole = Math.max(long, wide / this.#aspect) * 1.15;
    const fits = isPlan && whole <= PLAN_M;
    this.framed = null;
    this.orbit.target = fits ? [(min[0] + max[0]) / 2, (min[1] + max[1]) / 2, at[2]] : at;
    this.orbit.distance = isPlan ? clamp(whole, 2, PLAN_M) : clamp(1.2 * Math.hypot(wide, long, max[2] - min[2]), 2, AROUND_M);
    this.orbit.look.heading = isPlan ? 0 : heading;
    if (!isPlan) this.orbit.look.pitch = -40;
  }

  /** The area that a plan shows: minimum and maximum of x and y. */
  get area(): readonly [number, number, number, number] {
    const { target, distance, look } = this.orbit;
    const [sin, cos] = [Math.abs(Math.sin(look.heading * RADIANS)), Math.abs(Math.cos(look.heading * RADIANS))];
    const [wide, high] = [(distance / 2) * this.#aspect, distance / 2];
    const [x, y] = [wide * cos + high * sin, wide * sin + high * cos];
    return [target[0] - x, target[1] - y, target[0] + x, target[1] + y];
  }

  /** Heading that points up on the screen, or ahead. */
  heading(look: Look): number {
    return this.#mode === "walk" ? look.heading : this.orbit.look.heading;
  }

  turn(heading: number, pitch: number): void {
    const { look } = this.orbit;
    look.heading = wrap(look.heading + heading);
    look.pitch = clamp(look.pitch + pitch, -89, 20);
  }

  /** Pans by a fraction of the screen's height, as if dragged. */
  pan(right: number, up: number): void {
    const { orbit } = this;
    const sides = across(orbit.look.heading);
    const size = orbit.distance * 0.9;
    const move = (axis: 0 | 1): number => (-right * sides.right[axis] - up * sides.forward[axis]) * size;
    orbit.target = [orbit.target[0] + move(0), orbit.target[1] + move(1), orbit.target[2]];
  }

  zoom(factor: number): void {
    this.orbit.distance = clamp(this.orbit.distance * factor, 0.3, 8000);
  }

  update(mode: Mode, world: World, eye: Vec3, look: Look): void {
    this.#mode = mode;
    const { orbit } = this;
    if (mode === "walk") {
      this.#forward = direction(look);
      this.#position = eye;
    } else {
      this.#forward = direction(mode === "plan" ? { heading: orbit.look.heading, pitch: -90 } : orbit.look);
      this.#position = add(orbit.target, this.#forward, mode === "plan" ? -2000 : -orbit.distance);
    }
    const camera = this.current;
    camera.position.copy(world.local(this.#position));
    if (mode === "plan") {
      const ahead = across(orbit.look.heading).forward;
      camera.up.set(ahead[0], ahead[1], 0);
      const half = orbit.distance / 2;
      Object.assign(this.#top, { left: -half * this.#aspect, right: half * this.#aspect, top: half, bottom: -half });
      this.#top.updateProjectionMatrix();
    } else {
      camera.up.copy(UP);
      this.#eye.aspect = this.#aspect;
      this.#eye.fov = this.#field;
      this.#eye.near = mode === "walk" ? 0.04 : Math.max(0.02, orbit.distance / 300);
      this.#eye.updateProjectionMatrix();
    }
    camera.lookAt(world.local(add(this.#position, this.#forward)));
    camera.updateMatrixWorld();
  }

  /** The ray through a point of the screen: x and y from -1 (left, bottom) to 1. */
  ray(x: number, y: number, world: World): Ray {
    const camera = this.current;
    if (this.#mode === "plan") {
      const start = new Vector3(x, y, -1).unproject(camera);
      return { origin: world.world(start), direction: this.#forward };
    }
    const end = new Vector3(x, y, 0.5).unproject(camera).sub(camera.position).normalize();
    return { origin: this.#position, direction: [end.x, end.y, end.z] };
  }

  /** Screen position of a place in the scan, 0 to 1 from the top left; null behind the camera. */
  project(at: Vec3, world: World): readonly [number, number] | null {
    const seen = world.local(at).project(this.current);
    return Math.abs(seen.z) <= 1 ? [(seen.x + 1) / 2, (1 - seen.y) / 2] : null;
  }
}
