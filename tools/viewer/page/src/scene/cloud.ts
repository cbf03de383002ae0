// A point cloud drawn over the archive, only for display: collisions use the archive.

import type { Vec3 } from "slicewalk";
import { BufferAttribute, BufferGeometry, Group, Points, PointsMaterial } from "three";
import type { CloudAnswer, CloudRequest } from "./cloud-worker";
import type { World } from "./world";

const MOST_POINTS = 2_000_000;
const POINT_M = 0.02;

export class Cloud {
  readonly group = new Group();
  readonly #material = new PointsMaterial({ size: POINT_M, vertexColors: true });
  readonly #origin: Vec3;
  readonly #worker = new Worker(new URL("./cloud-worker.ts", import.meta.url), { type: "module" });

  /** `told` receives the number of points at the end, or an error message. */
  constructor(url: string, near: Vec3, unit: number, told: (points: number | string) => void) {
    this.#origin = [Math.round(near[0]), Math.round(near[1]), Math.round(near[2])];
    this.#worker.addEventListener("message", ({ data }: MessageEvent<CloudAnswer>) => {
      if ("part" in data) {
        const geometry = new BufferGeometry();
        geometry.setAttribute("position", new BufferAttribute(data.part.positions, 3));
        geometry.setAttribute("color", new BufferAttribute(data.part.colours, 3, true));
        this.group.add(new Points(geometry, this.#material));
      } else {
        told("done" in data ? data.done : data.error);
        this.#worker.terminate();
      }
    });
    const request: CloudRequest = { url, origin: [...this.#origin] as [number, number, number], unit, most: MOST_POINTS };
    this.#worker.postMessage(request);
  }

  /** Follows the scene's local origin. */
  place(world: World): void {
    this.group.position.copy(world.local(this.#origin));
  }

  close(): void {
    this.#worker.terminate();
    this.group.children.forEach((points) => (points as Points).geometry.dispose());
    this.group.clear();
    this.#material.dispose();
  }
}
