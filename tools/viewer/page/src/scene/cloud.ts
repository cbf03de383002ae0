// A point cloud drawn over the archive, only for display: collisions use the archive. Near the eye its points cover the surface;
// farther away they thin out, where a pixel of the archive is no wider than two of the screen.

import type { Vec3 } from "slicewalk";
import { BufferAttribute, BufferGeometry, GLSL3, Group, Points, ShaderMaterial } from "three";
import { distance } from "../geometry";
import type { CloudAnswer, CloudLook, CloudRequest } from "./cloud-worker";
import { EXPOSED } from "./material";
import type { World } from "./world";

/** Gap between points that looks closed (pixels of the screen). */
const CLOSED_PX = 1.5;
/** Width of a pixel of the archive on the screen at which points end, and the least distance for that. */
const ENDS_PX = 2;
const ENDS_M = 20;
/** Distance moved, as a share of the distance to what is looked at, after which other points are chosen; at least in metres. */
const MOVED_SHARE = 0.1;
const MOVED_M = 0.5;
/** Least width of a point (m). */
const POINT_M = 0.02;
/** How far points are lifted to the surface at most, relative to their distance. */
const MOST_LIFT = 0.015;
/** Longest viewing distance (m). */
const FAR_M = 1e5;

const vertex = /* glsl */ `
in vec3 paint;
out vec3 vColour;
uniform float focal;
uniform float gap;
uniform float far;
uniform float lift;
uniform bool isCut;
uniform vec2 cut;
uniform vec3 boxLow;
uniform vec3 boxHigh;
${EXPOSED}

float chance(int n) {
  uint word = uint(n) * 747796405u + 2891336453u;
  word = ((word >> ((word >> 28) + 4u)) ^ word) * 277803737u;
  return float((word >> 22) ^ word & 0x3ffu) / 1023.0;
}

void main() {
  vec4 local = modelMatrix * vec4(position, 1.0);
  vec4 seen = viewMatrix * local;
  float away = length(seen.xyz);
  bool isFlat = projectionMatrix[3][3] > 0.5;
  vColour = exposed(paint);
  gl_Position = projectionMatrix * seen;
  // Points lie within the solid that is drawn: they are as near as its surface. More than this would look like an edge.
  vec4 lifted = projectionMatrix * (seen + vec4(0.0, 0.0, min(lift, ${MOST_LIFT} * away), 0.0));
  if (lifted.w > 0.0) gl_Position.z = max(lifted.z / lifted.w, -1.0) * gl_Position.w;
  gl_PointSize = isFlat ? 2.0 : clamp(max(gap, ${POINT_M.toFixed(3)} / away) * focal * 1.4, 2.0, 12.0);
  bool hidden = isCut && (local.z > cut.y || local.z < cut.x || any(lessThan(local.xyz, boxLow)) || any(greaterThan(local.xyz, boxHigh)));
  if (hidden || chance(gl_VertexID) < smoothstep(0.5 * far, far, away)) gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
}`;

const fragment = /* glsl */ `
precision highp float;
in vec3 vColour;
out vec4 colour;
void main() {
  if (length(gl_PointCoord - 0.5) > 0.5) discard;
  colour = vec4(vColour, 1.0);
}`;

export class Cloud {
  readonly group = new Group();
  readonly #material: ShaderMaterial;
  readonly #uniforms;
  readonly #origin: Vec3;
  readonly #parts = new Map<string, Points>();
  readonly #worker = new Worker(new URL("./cloud-worker.ts", import.meta.url), { type: "module" });
  /** The look that was posted last. */
  #look: CloudLook | null = null;
  #told = false;
  /** Number of points drawn. */
  count = 0;
  /** Another number after each change of what is drawn. */
  revision = 0;

  /**
   * A cloud of which at most `most` points are drawn. `told` receives the number of points when those of the first look are drawn,
   * or an error message.
   */
  constructor(url: string, near: Vec3, unit: number, world: World, most: number, told: (points: number | string) => void) {
    this.#origin = [Math.round(near[0]), Math.round(near[1]), Math.round(near[2])];
    const { cut, boxLow, boxHigh, exposure } = world.shading.uniforms;
    this.#uniforms = {
      focal: { value: 600 },
      gap: { value: 0 },
      far: { value: FAR_M },
      lift: { value: 1.5 * Math.max(world.pixelSize, world.sliceHeight) },
      isCut: { value: false },
      cut,
      boxLow,
      boxHigh,
      exposure,
    };
    this.#material = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: vertex,
      fragmentShader: fragment,
      uniforms: this.#uniforms,
    });
    this.#worker.addEventListener("message", ({ data }: MessageEvent<CloudAnswer>) => {
      if ("part" in data) this.#add(data.part.name, data.part.positions, data.part.colours);
      else if ("gone" in data) this.#remove(data.gone);
      else if ("done" in data) {
        this.#uniforms.gap.value = data.gap;
        this.revision += 1;
        if (!this.#told) told(data.done);
        this.#told = true;
      } else {
        told(data.error);
        this.#worker.terminate();
      }
    });
    const request: CloudRequest = { url, origin: [...this.#origin] as [number, number, number], unit, most };
    this.#worker.postMessage(request);
  }

  #add(name: string, positions: Float32Array, colours: Uint8Array): void {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(positions, 3));
    geometry.setAttribute("paint", new BufferAttribute(colours, 3, true));
    const points = new Points(geometry, this.#material);
    this.#parts.set(name, points);
    this.count += positions.length / 3;
    this.revision += 1;
    this.group.add(points);
  }

  #remove(name: string): void {
    const points = this.#parts.get(name);
    if (points === undefined) return;
    this.#parts.delete(name);
    this.count -= points.geometry.getAttribute("position").count;
    this.revision += 1;
    this.group.remove(points);
    points.geometry.dispose();
  }

  /**
   * Follows the scene's local origin, and the eye: `reach` is the distance to what it looks at (m), null if it looks around itself;
   * `focal` is the height of the picture by that of what it shows at a distance of 1 (pixels).
   */
  follow(world: World, eye: Vec3, reach: number | null, focal: number): void {
    this.group.position.copy(world.local(this.#origin));
    // Seen from outside, all of it is drawn.
    const far = reach === null ? Math.max(ENDS_M, (world.pixelSize * focal) / ENDS_PX) : FAR_M;
    this.#uniforms.focal.value = focal;
    this.#uniforms.far.value = far;
    this.#uniforms.isCut.value = world.shading.effort.cut;
    const before = this.#look;
    const least = Math.max(MOVED_M, MOVED_SHARE * (reach ?? 0));
    const isSame = before !== null && before.far === far && distance(before.eye, eye) < least;
    if (isSame) return;
    this.#look = { eye: [eye[0], eye[1], eye[2]], far, finest: CLOSED_PX / focal };
    this.#worker.postMessage(this.#look);
  }

  close(): void {
    this.#worker.terminate();
    [...this.#parts.keys()].forEach((name) => this.#remove(name));
    this.#material.dispose();
  }
}
