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
    this.#way.geometry.setAttribute("position", new BufferAttribute(new Float32Array(6), 3));
    this.group.add(this.#ring, this.#way);
    this.group.visible = false;
  }

  /** Shows where a pawn at `from` walks; null: nowhere. Seen from a distance, the ring is larger. */
  show(world: World, from: Vec3, to: Vec3 | null, metresHigh: number): void {
    this.group.visible = to !== null;
    if (to === null) return;
    const [a, b] = [world.local(from), world.local(to)];
    this.#ring.position.set(b.x, b.y, b.z + ABOVE_M);
    this.#ring.scale.setScalar(Math.max(1, metresHigh / 30));
    const places = this.#way.geometry.getAttribute("position");
    places.setXYZ(0, a.x, a.y, a.z + ABOVE_M);
    places.setXYZ(1, b.x, b.y, b.z + ABOVE_M);
    places.needsUpdate = true;
  }
}
