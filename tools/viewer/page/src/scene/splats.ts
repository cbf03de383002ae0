// Gaussian splats drawn over the archive, only for display: collisions use the archive. The renderer is a separate
// chunk, fetched with the first file of splats.

import type { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
import { Euler, Group, type WebGLRenderer } from "three";
import type { Alignment, Up } from "./alignment";
import type { World } from "./world";

/** Rotation about x from their axes to those of a scan. */
const TILT: Record<Up, number> = { z: 0, y: Math.PI / 2, "-y": -Math.PI / 2 };

export class Splats {
  readonly group = new Group();
  readonly count: number;

  private constructor(
    readonly renderer: SparkRenderer,
    readonly mesh: SplatMesh,
  ) {
    this.count = mesh.numSplats;
    this.group.add(renderer, mesh);
  }

  /** Reads a file or an address. */
  static async load(source: string | File, renderer: WebGLRenderer): Promise<Splats> {
    const [fileBytes, { SparkRenderer, SplatMesh }] = await Promise.all([read(source), import("@sparkjsdev/spark")]);
    const fileName = typeof source === "string" ? new URL(source).pathname : source.name;
    // Extended: 32 bits per coordinate, because 16 would be off by centimetres in a large scan.
    const mesh = new SplatMesh({ fileBytes, fileName, extSplats: true, editable: false, raycastable: false });
    try {
      await mesh.initialized;
      if (mesh.numSplats === 0) throw new Error("the file holds no splats");
    } catch (error) {
      mesh.dispose();
      throw error;
    }
    return new Splats(new SparkRenderer({ renderer }), mesh);
  }

  /** Places the splats; follows the scene's local origin. */
  place({ at, turn, scale, up }: Alignment, world: World): void {
    this.mesh.position.copy(world.local(at));
    this.mesh.quaternion.setFromEuler(new Euler(TILT[up], 0, (-turn * Math.PI) / 180, "ZYX"));
    this.mesh.scale.setScalar(scale);
  }

  close(): void {
    this.mesh.dispose();
    this.renderer.dispose();
    this.group.clear();
  }
}

async function read(source: string | File): Promise<ArrayBuffer> {
  if (typeof source !== "string") return source.arrayBuffer();
  const answer = await fetch(source);
  if (!answer.ok) throw new Error(`the host answers ${answer.status} ${answer.statusText}`.trimEnd());
  return answer.arrayBuffer();
}
