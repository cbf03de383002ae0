// The finish of a picture from its depth, in one pass: creases and corners are darker, and edges against what lies behind
// them stand out. On a plane, 1/distance is linear across the screen, so planes of any slope stay as they are.

import {
  BufferAttribute,
  BufferGeometry,
  DepthTexture,
  GLSL3,
  Mesh,
  NearestFilter,
  OrthographicCamera,
  Scene,
  ShaderMaterial,
  UnsignedIntType,
  Vector2,
  WebGLRenderTarget,
  type Camera,
  type WebGLRenderer,
} from "three";
import { NO_SCAN } from "./sky";

const SAMPLES = 4;

const vertex = /* glsl */ `
void main() {
  gl_Position = vec4(position.xy, 0.0, 1.0);
}`;

const fragment = /* glsl */ `
precision highp float;
precision highp sampler2D;
uniform sampler2D picture;
uniform sampler2D depth;
uniform vec2 size;
uniform float wide;
out vec4 colour;

float nearness(ivec2 at) {
  return 1.0 - texelFetch(depth, clamp(at, ivec2(0), ivec2(size) - 1), 0).r;
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 own = texelFetch(picture, at, 0);
  float here = nearness(at);
  bool scanned = here > 0.0;
  float crease = 0.0;
  float edge = 0.0;
  const ivec2 ways[4] = ivec2[4](ivec2(1, 0), ivec2(0, 1), ivec2(1, 1), ivec2(-1, 1));
  for (int ring = 0; ring < 2; ring++) {
    int far = int(wide * (ring == 0 ? 1.0 : 5.0) + 0.5);
    for (int n = 0; n < 4; n++) {
      ivec2 way = ways[n] * (n < 2 || ring == 0 ? far : far * 3 / 4);
      float a = nearness(at + way);
      float b = nearness(at - way);
      // Positive where the neighbours are nearer than a plane through here.
      float bend = (0.5 * (a + b) - here) / max(here, 1e-7);
      crease += min(max(bend, 0.0), ring == 0 ? 0.12 : 0.25) * (ring == 0 ? 1.4 : 0.55);
      if (ring == 0) edge += clamp(-bend * 3.0, 0.0, 0.25);
    }
  }
  float shade = scanned ? 1.0 - 0.55 * (1.0 - exp(-2.2 * crease)) + 0.05 * min(edge, 1.0) : 1.0 - 0.12 * min(edge, 0.0);
  colour = vec4(own.rgb * shade, scanned ? 1.0 : ${NO_SCAN});
}`;

export class Finish {
  readonly #target: WebGLRenderTarget;
  readonly #scene = new Scene();
  readonly #camera = new OrthographicCamera(-1, 1, 1, -1, 0, 1);
  readonly #uniforms;

  constructor() {
    this.#target = new WebGLRenderTarget(1, 1, { depthTexture: new DepthTexture(1, 1, UnsignedIntType) });
    this.#target.texture.minFilter = this.#target.texture.magFilter = NearestFilter;
    this.#uniforms = {
      picture: { value: this.#target.texture },
      depth: { value: this.#target.depthTexture },
      size: { value: new Vector2() },
      wide: { value: 1 },
    };
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]), 3));
    const material = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: vertex,
      fragmentShader: fragment,
      uniforms: this.#uniforms,
      depthTest: false,
      depthWrite: false,
    });
    const mesh = new Mesh(geometry, material);
    mesh.frustumCulled = false;
    this.#scene.add(mesh);
  }

  /** Draws `scene` with this finish; `smooth`: with smooth outlines. */
  render(renderer: WebGLRenderer, scene: Scene, camera: Camera, smooth: boolean): void {
    const { size, wide } = this.#uniforms;
    renderer.getDrawingBufferSize(size.value);
    const samples = smooth ? SAMPLES : 0;
    if (this.#target.samples !== samples) {
      this.#target.samples = samples;
      this.#target.dispose();
    }
    this.#target.setSize(size.value.x, size.value.y);
    wide.value = Math.max(1, size.value.y / 600);
    renderer.setRenderTarget(this.#target);
    renderer.render(scene, camera);
    renderer.setRenderTarget(null);
    renderer.render(this.#scene, this.#camera);
  }
}
