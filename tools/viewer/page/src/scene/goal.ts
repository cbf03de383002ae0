// The place that the pawn walks to: a ring on its floor, the way there, and where it is blocked.

import type { Vec3 } from "slicewalk";
import {
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  Group,
  Line,
  LineBasicMaterial,
  Mesh,
  MeshBasicMaterial,
  RingGeometry,
} from "three";
import type { Obstacle } from "../obstacle";
import type { World } from "./world";

const [INNER_M, OUTER_M] = [0.22, 0.3];
const ABOVE_M = 0.03;
const ACCENT = "#ffb547";
const STOP = "#d63c2f";

const ring = (inner: number, outer: number, color: string): Mesh =>
  new Mesh(
    new RingGeometry(inner, outer, 32),
    new MeshBasicMaterial({ color, transparent: true, opacity: 0.9, depthTest: false, side: DoubleSide }),
  );

export class Goal {
  readonly group = new Group();
  readonly #ring = ring(INNER_M, OUTER_M, ACCENT);
  /** Filled, and in another colour, so that it differs without colours too. */
  readonly #stop = ring(0, INNER_M, STOP);
  readonly #way = new Line(
    new BufferGeometry(),
    new LineBasicMaterial({ color: ACCENT, transparent: true, opacity: 0.7, depthTest: false }),
  );

  constructor() {
    this.#way.frustumCulled = false;
    this.group.add(this.#ring, this.#stop, this.#way);
    this.group.visible = false;
  }

  /**
   * Shows the places to which a pawn walks, from where it is; none: it walks nowhere. Where an obstacle ends its way, shows that
   * place and the way of a pawn that passes. Seen from a distance, the rings are larger.
   */
  show(world: World, way: readonly Vec3[], obstacle: Obstacle | null, metresHigh: number): void {
    const last = way.at(-1);
    const end = obstacle?.way.at(-1) ?? last;
    this.group.visible = end !== undefined;
    if (end === undefined) return;
    this.#at(this.#ring, world, end, metresHigh);
    this.#stop.visible = obstacle !== null;
    if (obstacle !== null) this.#at(this.#stop, world, obstacle.at, metresHigh);
    const places = (obstacle?.way ?? way).map((place) => world.local(place));
    const { geometry } = this.#way;
    if (geometry.getAttribute("position")?.count !== places.length) {
      geometry.dispose();
      geometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * places.length), 3));
    }
    const points = geometry.getAttribute("position");
    places.forEach((place, n) => points.setXYZ(n, place.x, place.y, place.z + ABOVE_M));
    points.needsUpdate = true;
  }

  #at(mark: Mesh, world: World, at: Vec3, metresHigh: number): void {
    mark.position.copy(world.local(at));
    mark.position.z += ABOVE_M;
    mark.scale.setScalar(Math.max(1, metresHigh / 30));
  }
}
