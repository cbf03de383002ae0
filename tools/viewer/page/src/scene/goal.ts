// The place that the pawn walks to: a ring on its floor, and the way there.

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
import type { World } from "./world";

const [INNER_M, OUTER_M] = [0.22, 0.3];
const ABOVE_M = 0.03;
const ACCENT = "#ffb547";

export class Goal {
  readonly group = new Group();
  readonly #ring = new Mesh(
    new RingGeometry(INNER_M, OUTER_M, 32),
    new MeshBasicMaterial({ color: ACCENT, transparent: true, opacity: 0.9, depthTest: false, side: DoubleSide }),
  );
  readonly #way = new Line(
    new BufferGeometry(),
    new LineBasicMaterial({ color: ACCENT, transparent: true, opacity: 0.7, depthTest: false }),
  );

  constructor() {
    this.#way.frustumCulled = false;
    this.group.add(this.#ring, this.#way);
    this.group.visible = false;
  }

  /** Shows the places to which a pawn walks, from where it is; none: it walks nowhere. Seen from a distance, the ring is larger. */
  show(world: World, way: readonly Vec3[], metresHigh: number): void {
    const places = way.map((place) => world.local(place));
    const last = places.at(-1);
    this.group.visible = last !== undefined;
    if (last === undefined) return;
    this.#ring.position.set(last.x, last.y, last.z + ABOVE_M);
    this.#ring.scale.setScalar(Math.max(1, metresHigh / 30));
    const { geometry } = this.#way;
    if (geometry.getAttribute("position")?.count !== places.length) {
      geometry.dispose();
      geometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * places.length), 3));
    }
    const points = geometry.getAttribute("position");
    places.forEach((place, n) => points.setXYZ(n, place.x, place.y, place.z + ABOVE_M));
    points.needsUpdate = true;
  }
}
