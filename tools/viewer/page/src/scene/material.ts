// Appearance of solid: shaded by its face, coloured by height, slope, kind or slice, and cut between two heights.

import {
  DoubleSide,
  FrontSide,
  GLSL3,
  ShaderMaterial,
  Vector2,
  Vector3,
  Vector4,
  Color,
  type DataTexture,
  type IUniform,
  type Material,
} from "three";
import type { Cover } from "./cover";
import { PLAIN, type Paint } from "./paint";

export type Colouring = "height" | "slope" | "obstacle" | "slice" | "scan";

/** The index of a colouring is its number in the shader. */
export const COLOURINGS: readonly Colouring[] = ["height", "slope", "obstacle", "slice", "scan"];

/** From low to high; distinguishable also for the colour-blind. */
export const RAMP = ["#7d93bd", "#74adb8", "#a3c6a1", "#e3d29d", "#e2a67c"] as const;
export const FLOOR = "#9db4c4";
export const OBSTACLE = "#d98a68";

/** Colours pass to the screen unchanged: the shaders work in the screen's colour space. */
export const plain = (hex: string): Vector3 => {
  const { r, g, b } = new Color().setStyle(hex, "srgb-linear");
  return new Vector3(r, g, b);
};

/** The scan's colours as they are drawn. */
export const EXPOSED = /* glsl */ `
uniform vec3 exposure;
vec3 exposed(vec3 own) {
  vec3 lit = clamp((own - exposure.x) * exposure.y, 0.0, 1.0);
  return lit + exposure.z * (lit * (1.0 - lit) + 0.09 * (1.0 - lit));
}`;

const vertex = /* glsl */ `
in vec4 attributes;
out vec3 vLocal;
out vec3 vCell;
out float vDistance;
out vec3 vNormal;
flat out vec3 vFace;
flat out vec3 vKind;
void main() {
  vec4 local = modelMatrix * vec4(position, 1.0);
  vec4 seen = viewMatrix * local;
  vLocal = local.xyz;
  vCell = position;
  vNormal = normal;
  vFace = attributes.x > 1.5 ? sign(normal) : vec3(0.0, 0.0, 1.0 - 2.0 * attributes.x);
  vKind = attributes.xyz;
  vDistance = length(seen.xyz);
  gl_Position = projectionMatrix * seen;
}`;

const fragment = /* glsl */ `
precision highp float;
#ifdef OVERVIEW
precision highp sampler3D;
uniform sampler3D cover;
uniform vec3 page;
uniform vec3 coverRest;
uniform vec3 coverWrap;
uniform vec3 coverDelta;
#endif
precision highp usampler2D;
in vec3 vLocal;
in vec3 vCell;
in float vDistance;
in vec3 vNormal;
flat in vec3 vFace;
flat in vec3 vKind;
uniform usampler2D paintCells;
uniform sampler2D paintColours;
uniform vec3 paintShare;
uniform vec4 paintUsual;
uniform int colouring;
uniform vec2 heights;
uniform vec2 cut;
uniform vec3 boxLow;
uniform vec3 boxHigh;
uniform vec2 slicing;
uniform vec2 pawnSlice;
uniform float slope;
uniform float far;
uniform float fogShare;
${EXPOSED}
uniform vec3 sun;
uniform vec3 haze;
uniform vec3 ramp[5];
uniform vec3 floorColour;
uniform vec3 obstacleColour;
uniform vec3 background;
out vec4 colour;

vec3 onRamp(float share) {
  float place = clamp(share, 0.0, 1.0) * 4.0;
  int below = min(int(place), 3);
  return mix(ramp[below], ramp[below + 1], place - float(below));
}

// A little grain per cell makes motion visible on large plain faces.
float grain(vec3 cell) {
  vec3 p = fract(floor(cell) * vec3(0.1031, 0.1030, 0.0973));
  p += dot(p, p.yzx + 33.33);
  return fract((p.x + p.y) * p.z);
}

uint ones(uint word) {
  word -= (word >> 1) & 0x55555555u;
  word = (word & 0x33333333u) + ((word >> 2) & 0x33333333u);
  return (((word + (word >> 4)) & 0x0F0F0F0Fu) * 0x01010101u) >> 24;
}

// The scan's colour of a voxel, by its cell and slice, or of the nearest one above or below. Alpha 0: none.
vec4 scannedAt(ivec2 at, int slice, int reach) {
  uvec4 cell = texelFetch(paintCells, at, 0);
  if ((cell.x | cell.y) == 0u) return vec4(0.0);
  for (int n = 0; n <= 2 * reach; n++) {
    int k = slice + ((n & 1) == 1 ? -(n + 1) / 2 : n / 2);
    if (k < 0 || k > 63) continue;
    uint word = k < 32 ? cell.x : cell.y;
    uint bit = uint(k & 31);
    if (((word >> bit) & 1u) == 0u) continue;
    uint rank = cell.z + ones(word & ((1u << bit) - 1u)) + (k < 32 ? 0u : ones(cell.x));
    return vec4(texelFetch(paintColours, ivec2(rank & 255u, rank >> 8), 0).rgb, 1.0);
  }
  return vec4(0.0);
}

// The scan's colour behind the face. Drawn heights are rounded, the more so the larger the cells of the drawing.
vec4 scanned() {
  int edge = textureSize(paintCells, 0).x;
  vec3 place = vCell * paintShare;
  place -= vFace * vec3(0.3 / float(edge), 0.3 / float(edge), 0.02);
  ivec2 at = clamp(ivec2(floor(place.xy * float(edge))), ivec2(0), ivec2(edge - 1));
  int slice = int(floor(place.z));
  int reach = 3 * max(1, int(64.0 * paintShare.x + 0.5));
  vec4 found = scannedAt(at, slice, reach);
  // Cells of colours may be finer than those of the drawing: solid need not fill all of them.
  int wide = int(float(edge) * paintShare.x + 0.5);
  if (found.a > 0.5 || wide < 2) return found;
  ivec2 first = at / wide * wide;
  int step = max(1, wide / 4);
  for (int n = 0; n < 16; n++) {
    ivec2 other = ivec2(n & 3, n >> 2) * step;
    if (max(other.x, other.y) >= wide) continue;
    found = scannedAt(first + other, slice, reach);
    if (found.a > 0.5) return found;
  }
  return found;
}

// Colours of the four voxels around a place of a face, blended by their distance.
vec4 blended() {
  int edge = textureSize(paintCells, 0).x;
  vec3 grid = vCell * paintShare * vec3(float(edge), float(edge), 1.0);
  vec3 within = 1.0 - abs(vFace);
  grid -= vFace * vec3(0.3, 0.3, 0.02) + 0.5 * within;
  vec3 low = floor(grid);
  vec3 part = grid - low;
  int reach = 3 * max(1, int(64.0 * paintShare.x + 0.5));
  vec4 sum = vec4(0.0);
  for (int n = 0; n < 4; n++) {
    vec2 on = vec2(float(n & 1), float(n >> 1));
    vec3 next = within.z < 0.5 ? vec3(on, 0.0) : within.x < 0.5 ? vec3(0.0, on) : vec3(on.x, 0.0, on.y);
    vec3 weights = mix(vec3(1.0), mix(1.0 - part, part, next), within);
    vec3 place = low + next;
    ivec2 at = clamp(ivec2(place.xy), ivec2(0), ivec2(edge - 1));
    // A little of each, so that a lone voxel keeps its colour.
    sum += scannedAt(at, int(place.z), within.z < 0.5 ? reach : 1) * (weights.x * weights.y * weights.z + 1e-4);
  }
  return sum.a > 0.0 ? vec4(sum.rgb / sum.a, 1.0) : scanned();
}

#ifdef OVERVIEW
// Returns whether the page behind this face is drawn in full.
bool covered() {
  vec3 place = floor((vLocal - 0.01 * vFace + coverRest) / page);
  ivec3 size = textureSize(cover, 0);
  if (any(greaterThanEqual(abs(place + coverDelta), vec3(size / 2)))) return false;
  return texelFetch(cover, ivec3(place + coverWrap) & (size - 1), 0).r > 0.5;
}
#endif

void main() {
  float z = vLocal.z - 1e-4 * vFace.z;
#ifdef CUT
  if (vLocal.z > cut.y || any(lessThan(vLocal, boxLow)) || any(greaterThan(vLocal, boxHigh))) discard;
  if (gl_FrontFacing && vLocal.z < cut.x) {
    // Below the shown slice: hides what is inside it, and shows nothing.
    colour = vec4(background, 1.0);
    return;
  }
  // Seen from inside, solid was cut open: show it as if filled up to the cut.
  if (!gl_FrontFacing) z = min(cut.y, boxHigh.z) - 1e-4;
#endif
#ifdef OVERVIEW
  if (covered()) discard;
#endif
  vec3 base;
  if (colouring == 1) {
    base = vKind.z > slope ? mix(obstacleColour, vec3(0.55, 0.16, 0.16), clamp((vKind.z - slope) / (90.5 - slope), 0.0, 1.0))
                           : mix(ramp[1], ramp[3], vKind.z / max(slope, 1.0));
  } else if (colouring == 2) {
    base = vKind.y > 0.5 ? obstacleColour : floorColour;
  } else if (colouring == 3) {
    // Colours of the thesis: red is the height within the slice, blue 255 for obstacles and 26 for floors, green 255.
    base = vec3(fract((z - slicing.x) / slicing.y), 1.0, vKind.y > 0.5 ? 1.0 : 26.0 / 255.0);
  } else {
    base = onRamp((z - heights.x) / max(heights.y - heights.x, 0.01));
  }
  // Light of the sky from above, and of the sun by the slope of the surface.
  float shade = 0.7 + 0.12 * vNormal.z + 0.26 * max(dot(vNormal, sun), 0.0);
#ifdef SCAN
  {
#ifdef FINE
    vec4 own = vDistance < 60.0 ? blended() : scanned();
#else
    vec4 own = scanned();
#endif
    if (own.a < 0.5) own = paintUsual;
    // Without a colour, the grey of its height.
    base = own.a > 0.5 ? exposed(own.rgb) : mix(vec3(dot(base, vec3(0.33))), base, 0.2);
    // The scan's colours include its lighting, so shade them less.
    shade = mix(1.0, shade, 0.6);
  }
#endif
#ifdef FINE
  float near = 1.0 - smoothstep(4.0, 14.0, vDistance);
  if (near > 0.0) shade *= 1.0 + 0.05 * near * (grain(vCell + 0.01) - 0.5);
#endif
#ifdef CUT
  if (!gl_FrontFacing) {
    if (colouring != 3) base = mix(base, vec3(0.93), 0.35);
    shade = 1.0;
  }
#endif
  if (colouring == 3 && z >= pawnSlice.x && z < pawnSlice.y) shade *= 1.12;
  else if (colouring == 3 && pawnSlice.y > pawnSlice.x) base = mix(base, vec3(dot(base, vec3(0.33))), 0.45) * 0.8;
  // Air: what is far takes the colour of the horizon, but never all of it.
  float air = fogShare * min(0.75, vDistance / far);
  colour = vec4(mix(base * shade, haze, air * air), 1.0);
}`;

/**
 * Optional parts of the shaders: colours of the scan, fine ones (blended, with some grain), solid cut open. Each is a
 * shader of its own, because graphics by the processor compute all branches.
 */
export interface Effort {
  readonly scan: boolean;
  readonly fine: boolean;
  readonly cut: boolean;
}

/** All uniforms; heights are relative to the scene's local origin. */
export class Shading {
  readonly uniforms: {
    colouring: IUniform<number>;
    heights: IUniform<Vector2>;
    cut: IUniform<Vector2>;
    /** The section box. */
    boxLow: IUniform<Vector3>;
    boxHigh: IUniform<Vector3>;
    slicing: IUniform<Vector2>;
    pawnSlice: IUniform<Vector2>;
    slope: IUniform<number>;
    far: IUniform<number>;
    fogShare: IUniform<number>;
    ramp: IUniform<Vector3[]>;
    floorColour: IUniform<Vector3>;
    obstacleColour: IUniform<Vector3>;
    background: IUniform<Vector3>;
    /** Darkest value of the scan's colours, what they are multiplied with, and how much their middle is lifted. */
    exposure: IUniform<Vector3>;
    sun: IUniform<Vector3>;
    haze: IUniform<Vector3>;
    paintUsual: IUniform<Vector4>;
    paintCells: IUniform<DataTexture>;
    paintColours: IUniform<DataTexture>;
    paintShare: IUniform<Vector3>;
  };
  readonly #materials = new Map<string, ShaderMaterial>();
  #effort: Effort = { scan: false, fine: false, cut: false };

  constructor(readonly cover: Cover) {
    this.uniforms = {
      colouring: { value: 0 },
      heights: { value: new Vector2(0, 1) },
      cut: { value: new Vector2(-1e9, 1e9) },
      boxLow: { value: new Vector3() },
      boxHigh: { value: new Vector3() },
      slicing: { value: new Vector2(0, 1) },
      pawnSlice: { value: new Vector2(0, 0) },
      slope: { value: 45 },
      far: { value: 40 },
      fogShare: { value: 1 },
      ramp: { value: RAMP.map(plain) },
      floorColour: { value: plain(FLOOR) },
      obstacleColour: { value: plain(OBSTACLE) },
      background: { value: new Vector3() },
      exposure: { value: new Vector3(0, 1, 0) },
      sun: { value: new Vector3(-0.45, -0.6, 0.66).normalize() },
      haze: { value: new Vector3() },
      paintUsual: { value: new Vector4() },
      paintCells: { value: PLAIN.cells },
      paintColours: { value: PLAIN.colours },
      paintShare: { value: new Vector3(1, 1, 1) },
    };
  }

  /** The uniforms that all pages share, as a text: another one after each change. */
  get shown(): string {
    return JSON.stringify(Object.entries(this.uniforms).filter(([name]) => !name.startsWith("paint")));
  }

  /** Materials of pages and of an overview that take this effort. */
  of(effort: Effort): readonly ShaderMaterial[] {
    return [false, true].map((overview) => this.#material(overview, effort));
  }

  /** What the materials handed out take. */
  get effort(): Effort {
    return this.#effort;
  }

  set effort(effort: Effort) {
    this.#effort = effort;
  }

  /** Material of the pages of this level. */
  material(level: number): ShaderMaterial {
    return this.#material(level > 0, this.#effort);
  }

  #material(overview: boolean, { scan, fine, cut }: Effort): ShaderMaterial {
    const parts = { OVERVIEW: overview, SCAN: scan, FINE: fine, CUT: cut };
    const defines = Object.fromEntries(Object.entries(parts).flatMap(([name, on]) => (on ? [[name, ""]] : [])));
    const name = Object.keys(defines).join();
    const known = this.#materials.get(name);
    if (known !== undefined) return known;
    const material = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: vertex,
      fragmentShader: fragment,
      uniforms: overview ? { ...this.uniforms, ...this.cover.uniforms } : this.uniforms,
      defines,
      // The inside of solid is seen only where it is cut open.
      side: cut ? DoubleSide : FrontSide,
    });
    this.#materials.set(name, material);
    return material;
  }

  /**
   * Colours of the next page drawn with this material: the fraction of a page in a cell, and slices per step. `usual`: of
   * what has no colours yet.
   */
  paint(material: Material, paint: Paint, share: Vector3, usual: Vector4): void {
    const { paintCells, paintColours, paintShare, paintUsual } = this.uniforms;
    if (!this.#effort.scan) return;
    [paintCells.value, paintColours.value] = [paint.cells, paint.colours];
    paintShare.value.copy(share);
    paintUsual.value.copy(usual);
    (material as ShaderMaterial).uniformsNeedUpdate = true;
  }

  set colouring(colouring: Colouring) {
    this.uniforms.colouring.value = COLOURINGS.indexOf(colouring);
  }
}
