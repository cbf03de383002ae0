// What is seen where nothing was scanned: the sky, the horizon and the ground plane, in a light and a dark theme.

import { BufferAttribute, BufferGeometry, GLSL3, Matrix4, Mesh, ShaderMaterial, Vector3, type Camera } from "three";
import { plain, type Shading } from "./material";

export type Theme = "light" | "dark";

/** Colours: zenith, horizon, ground, and paper of plans. */
const THEMES: Record<Theme, readonly [string, string, string, string]> = {
  light: ["#a7c1d9", "#e8edee", "#c4c2b8", "#f2f1ec"],
  dark: ["#1b2534", "#46525f", "#2b2f33", "#1c2026"],
};

/** Alpha of pixels that show no scan; others have 1. The page cannot tell the difference, the measure of cover can. */
export const NO_SCAN = 254 / 255;

const vertex = /* glsl */ `
uniform mat4 unproject;
out vec3 vWay;
void main() {
  // A triangle over the whole screen, behind everything.
  gl_Position = vec4(position.xy, 1.0, 1.0);
  vec4 far = unproject * vec4(position.xy, 1.0, 1.0);
  vWay = far.xyz / far.w - cameraPosition;
}`;

const fragment = /* glsl */ `
precision highp float;
in vec3 vWay;
uniform vec3 zenith;
uniform vec3 horizon;
uniform vec3 ground;
uniform float above;
uniform float reach;
out vec4 colour;
void main() {
  float up = vWay.z * inversesqrt(dot(vWay, vWay));
  vec3 seen = up > 0.0 ? mix(horizon, zenith, sqrt(up))
                       : mix(ground, horizon, clamp(above / (above - up * reach), 0.0, 1.0));
  colour = vec4(seen, ${NO_SCAN});
}`;

export class Sky {
  readonly mesh: Mesh;
  readonly #uniforms = {
    unproject: { value: new Matrix4() },
    zenith: { value: new Vector3() },
    horizon: { value: new Vector3() },
    ground: { value: new Vector3() },
    above: { value: 1 },
    reach: { value: 100 },
  };
  #paper = THEMES.light[3];
  #theme: Theme = "light";

  constructor() {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]), 3));
    const material = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: vertex,
      fragmentShader: fragment,
      uniforms: this.#uniforms,
      depthWrite: false,
    });
    this.mesh = new Mesh(geometry, material);
    this.mesh.frustumCulled = false;
    // Last, so that it costs only where nothing else is.
    this.mesh.renderOrder = 1000;
  }

  /** Colour of the paper of plans. */
  get paper(): string {
    return this.#paper;
  }

  get theme(): Theme {
    return this.#theme;
  }

  set theme(theme: Theme) {
    this.#theme = theme;
    const [zenith, horizon, ground, paper] = THEMES[theme];
    this.#uniforms.zenith.value = plain(zenith);
    this.#uniforms.horizon.value = plain(horizon);
    this.#uniforms.ground.value = plain(ground);
    this.#paper = paper;
  }

  /** Gives a scan the air of this sky. */
  light({ uniforms }: Shading, isPlan: boolean): void {
    uniforms.haze.value = this.#uniforms.horizon.value;
    uniforms.background.value = isPlan ? plain(this.#paper) : this.#uniforms.ground.value;
  }

  /** Follows the camera, which is `above` metres above the ground plane of a scan of this size. */
  follow(camera: Camera, isPlan: boolean, above: number, size: number): void {
    this.mesh.visible = !isPlan;
    this.#uniforms.unproject.value.multiplyMatrices(camera.matrixWorld, camera.projectionMatrixInverse);
    this.#uniforms.above.value = Math.max(above, 0.3);
    this.#uniforms.reach.value = Math.max(2 * size, 60);
  }
}
