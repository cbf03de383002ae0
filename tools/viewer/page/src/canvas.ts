// The canvas: renderer, size, the pawn's marker, and lost graphics contexts.

import {
  BoxGeometry,
  BufferAttribute,
  BufferGeometry,
  type Camera,
  Color,
  ConeGeometry,
  EdgesGeometry,
  Group,
  LineBasicMaterial,
  LineSegments,
  type Material,
  Mesh,
  MeshBasicMaterial,
  Scene,
  WebGLRenderer,
} from "three";
import type { Cameras } from "./scene/cameras";
import { Covered } from "./scene/covered";
import { Finish } from "./scene/finish";
import { Headset } from "./scene/headset";
import { NO_SCAN, Sky, type Theme } from "./scene/sky";
import type { World } from "./scene/world";
import type { Look } from "./geometry";
import type { WalkerState } from "slicewalk";

const MOST_PIXELS = 2;
/** A picture in which nothing changes is drawn again after this time (ms), in case the browser lost it. */
const AGAIN_MS = 4_000;
/** The same for splats, which are sorted between pictures; longer where graphics are computed by the processor. */
const SORTED_MS = 100;
const SORTED_SOFTWARE_MS = 700;
/** Pictures follow one another if they are at most so many frames apart; for so long (ms) they tell how fast graphics are. */
const FOLLOWS = 3;
const TELLING_MS = 500;

/** How much a picture may cost: as little as possible, a finish from its depth, and smooth outlines as well. */
export type Quality = "lowest" | "finished" | "smooth";

export class Canvas {
  readonly scene = new Scene();
  /** Marks above the picture. */
  readonly marks = new Scene();
  readonly sky = new Sky();
  /** Whether graphics are computed by the processor. */
  readonly isSoftware: boolean;
  quality: Quality = "finished";
  /** Number of pictures drawn. */
  pictures = 0;
  /** Pixels of the screen along a CSS pixel, at the last change of size. */
  #ratio = 0;
  /** Whether the last one was drawn without a finish. */
  #bare = false;
  /** What the last picture depends on. */
  #shown = "";
  #drawnAt = Number.NEGATIVE_INFINITY;
  /** Number of frames of the screen, and the frame and the time (ms) of the last picture. */
  #frames = 0;
  #pictureIn = Number.NEGATIVE_INFINITY;
  #pictureAt = 0;
  /** Frames and time (ms) between pictures that followed one another. */
  #pace = { frames: 0, ms: 0 };
  readonly #finish = new Finish();
  readonly #covered: Covered;
  readonly headset: Headset;
  readonly renderer: WebGLRenderer;
  readonly #marker = new Group();
  readonly #body: LineSegments;
  readonly #nose: Mesh;
  lost = false;

  constructor(
    readonly element: HTMLCanvasElement,
    readonly cameras: Cameras,
    readonly graphics: (lost: boolean) => void,
    readonly worn: (worn: boolean) => void,
  ) {
    this.renderer = new WebGLRenderer({ canvas: element, alpha: true, antialias: false, powerPreference: "high-performance" });
    this.renderer.info.autoReset = false;
    const gl = this.renderer.getContext() as WebGL2RenderingContext;
    this.#covered = new Covered(gl);
    const unmasked = gl.getExtension("WEBGL_debug_renderer_info");
    const name = String(gl.getParameter(unmasked?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER));
    this.isSoftware = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
    this.scene.add(this.sky.mesh);
    this.headset = new Headset(this.renderer, (worn) => {
      this.resize();
      this.worn(worn);
    });
    this.scene.add(this.headset.room);
    // three.js sorts transparent objects by `renderOrder`, so marks lie above the drawing of a plan.
    const ink = { color: "#ffb547", depthTest: false, transparent: true } as const;
    this.#body = new LineSegments(new EdgesGeometry(new BoxGeometry(1, 1, 1)), new LineBasicMaterial(ink));
    this.#nose = new Mesh(new ConeGeometry(0.28, 0.8, 4), new MeshBasicMaterial(ink));
    this.#body.renderOrder = this.#nose.renderOrder = 1;
    this.#marker.add(this.#body, this.#nose);
    this.marks.add(this.#marker);
    // three.js requests a new context and uploads everything again.
    element.addEventListener("webglcontextlost", () => {
      this.lost = true;
      this.#covered.lost();
      graphics(true);
    });
    element.addEventListener("webglcontextrestored", () => {
      this.lost = false;
      this.refresh();
      graphics(false);
    });
    // A hidden page draws nothing, and may lose its picture.
    const returned = (): void => {
      this.#pictureIn = Number.NEGATIVE_INFINITY;
      this.refresh();
    };
    document.addEventListener("visibilitychange", returned);
    window.addEventListener("pageshow", returned);
    new ResizeObserver(() => this.resize()).observe(element);
    this.resize();
  }

  resize(): void {
    const { clientWidth, clientHeight } = this.element;
    // A headset has its own size.
    if (clientWidth === 0 || clientHeight === 0 || this.headset.worn || this.renderer.xr.isPresenting) return;
    this.#ratio = devicePixelRatio;
    this.renderer.setPixelRatio(this.quality === "lowest" ? 1 : Math.min(devicePixelRatio, MOST_PIXELS));
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.cameras.resize(clientWidth, clientHeight);
    this.refresh();
  }

  /** Marks where the pawn stands, for views from outside. */
  mark(shown: boolean, world: World, state: WalkerState, look: Look, width: number, metresHigh: number): void {
    this.#marker.visible = shown;
    this.#marker.position.copy(world.local(state.at));
    this.#body.scale.set(width, width, state.height);
    this.#body.position.z = state.height / 2;
    const size = Math.max(1, metresHigh / 25);
    this.#nose.scale.setScalar(size);
    this.#nose.position.z = state.height / 2;
    this.#nose.rotation.z = (-look.heading * Math.PI) / 180;
  }

  /**
   * Compiles shaders ahead, in the background if the browser can; otherwise a frame would wait for it. `use`: draws with
   * them once as well, while nothing else is drawn.
   */
  async prepare(materials: readonly Material[], use = false): Promise<void> {
    const { renderer } = this;
    const scene = new Scene();
    // A degenerate triangle with the attributes of pages, which determine the shader.
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Uint16Array(9), 3));
    geometry.setAttribute("normal", new BufferAttribute(new Int8Array(12), 4, true));
    geometry.setAttribute("attributes", new BufferAttribute(new Uint8Array(12), 4));
    geometry.setIndex(new BufferAttribute(new Uint32Array(3), 1));
    const meshes = materials.map((material) => new Mesh(geometry, material));
    meshes.forEach((mesh) => (mesh.frustumCulled = false));
    scene.add(...meshes);
    if (renderer.extensions.has("KHR_parallel_shader_compile")) await renderer.compileAsync(scene, this.cameras.current);
    else renderer.compile(scene, this.cameras.current);
    // The first use of a shader waits for the graphics card.
    if (use && !this.lost) {
      renderer.render(scene, this.cameras.current);
      this.refresh();
    }
  }

  /** Calls back for each frame of the screen or the headset. */
  loop(frame: (now: number) => void): void {
    this.renderer.setAnimationLoop((now: number) => {
      this.#frames += 1;
      // Another screen may have other pixels, of which sizes in CSS pixels say nothing.
      if (devicePixelRatio !== this.#ratio) this.resize();
      frame(now);
    });
  }

  get camera(): Camera {
    return this.headset.worn ? this.headset.head : this.cameras.current;
  }

  /** Share of the last picture that shows the scan. */
  get covered(): number {
    return this.#covered.share;
  }

  /** Number of the picture for which it was measured: soon that of the last one. */
  get measured(): number {
    return this.#covered.picture;
  }

  /** Frames a second since the last call, while pictures followed one another; null if too few did to tell. */
  rate(): number | null {
    const { frames, ms } = this.#pace;
    this.#pace = { frames: 0, ms: 0 };
    return ms < TELLING_MS ? null : (1000 * frames) / ms;
  }

  /** Tells what the next picture depends on: it is drawn if that has changed. */
  show(what: string): void {
    if (what === this.#shown) return;
    this.#shown = what;
    this.refresh();
  }

  /** Draws if there is a reason to; `bare`: without a finish, for overlays that bring their own colours, which are splats. */
  render(now = performance.now(), bare = false): void {
    if (this.lost) return;
    const { renderer, camera } = this;
    const again = !bare ? AGAIN_MS : this.isSoftware ? SORTED_SOFTWARE_MS : SORTED_MS;
    if (!this.headset.worn && now - this.#drawnAt < again && !this.#covered.lacks(now)) return;
    const apart = this.#frames - this.#pictureIn;
    if (apart > 0 && apart <= FOLLOWS) {
      this.#pace.frames += apart;
      this.#pace.ms += now - this.#pictureAt;
    }
    this.#pictureIn = this.#frames;
    this.#pictureAt = this.#drawnAt = now;
    this.pictures += 1;
    this.#bare = bare;
    renderer.info.reset();
    if (this.headset.worn || bare || this.quality === "lowest") renderer.render(this.scene, camera);
    else this.#finish.render(renderer, this.scene, camera, this.quality === "smooth");
    if (this.headset.worn) return;
    if (this.marks.children.some((mark) => mark.visible && (mark.children.length > 0 || "geometry" in mark))) {
      renderer.autoClear = false;
      renderer.render(this.marks, camera);
      renderer.autoClear = true;
    }
    this.#covered.measure(now, this.pictures);
  }

  /** Empties the picture: nothing moves while nothing is open, and a conversion needs the processor. */
  clear(now = performance.now()): void {
    if (now - this.#drawnAt < AGAIN_MS) return;
    this.sky.mesh.visible = false;
    this.render(now, true);
  }

  /** Draws the next frame, whatever has changed. */
  refresh(): void {
    this.#drawnAt = Number.NEGATIVE_INFINITY;
  }

  /** Sets the colours of what was not scanned. */
  paint(theme: Theme): void {
    this.sky.theme = theme;
    this.renderer.setClearColor(new Color().setStyle(this.sky.paper, "srgb-linear"), NO_SCAN);
    this.refresh();
  }

  /** The current picture. */
  picture(): Promise<Blob | null> {
    this.refresh();
    this.render(performance.now(), this.#bare);
    return new Promise((resolve) => this.element.toBlob(resolve, "image/png"));
  }
}
