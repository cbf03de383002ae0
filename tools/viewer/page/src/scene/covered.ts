// Share of a picture that shows the scan, read from a small copy of it without waiting for the graphics card.

const WIDTH = 64;
const HEIGHT = 36;
const EVERY_MS = 250;

export class Covered {
  /** 0 to 1. */
  share = 0;
  /** Number of the picture that it is of. */
  picture = 0;
  #copy: WebGLFramebuffer | null = null;
  /** Receives the pixels; a new one each time, because browsers warn about one that is used again. */
  #pixels: WebGLBuffer | null = null;
  #fence: WebGLSync | null = null;
  #asked = 0;
  /** Numbers of the picture that is being read, and of the last one drawn. */
  #reading = 0;
  #last = 0;

  constructor(readonly gl: WebGL2RenderingContext) {}

  /** Forgets what a lost context took along. */
  lost(): void {
    this.#copy = this.#pixels = this.#fence = null;
  }

  /** Whether the last picture still has to be measured, and can be now: it must be drawn once more for that. */
  lacks(now: number): boolean {
    return this.#isFree(now) && this.picture < this.#last;
  }

  /** Call it after a picture is drawn on the canvas; `picture` is its number. */
  measure(now: number, picture: number): void {
    const { gl } = this;
    this.#last = picture;
    if (!this.#isFree(now)) return;
    this.#asked = now;
    this.#reading = picture;
    const copy = (this.#copy ??= this.#make());
    this.#pixels = gl.createBuffer();
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, copy);
    const { drawingBufferWidth: w, drawingBufferHeight: h } = gl;
    gl.blitFramebuffer(0, 0, w, h, 0, 0, WIDTH, HEIGHT, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, copy);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.#pixels);
    gl.bufferData(gl.PIXEL_PACK_BUFFER, 4 * WIDTH * HEIGHT, gl.STREAM_READ);
    gl.readPixels(0, 0, WIDTH, HEIGHT, gl.RGBA, gl.UNSIGNED_BYTE, 0);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    this.#fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
  }

  /** Reads what has arrived; returns whether another picture can be measured. */
  #isFree(now: number): boolean {
    const { gl } = this;
    if (this.#fence !== null && gl.getSyncParameter(this.#fence, gl.SYNC_STATUS) === gl.SIGNALED) this.#read();
    return this.#fence === null && now - this.#asked >= EVERY_MS;
  }

  #make(): WebGLFramebuffer {
    const { gl } = this;
    const [copy, colour] = [gl.createFramebuffer(), gl.createRenderbuffer()];
    gl.bindRenderbuffer(gl.RENDERBUFFER, colour);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA8, WIDTH, HEIGHT);
    gl.bindFramebuffer(gl.FRAMEBUFFER, copy);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, colour);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.bindRenderbuffer(gl.RENDERBUFFER, null);
    return copy;
  }

  #read(): void {
    const { gl } = this;
    gl.deleteSync(this.#fence);
    this.#fence = null;
    const found = new Uint8Array(4 * WIDTH * HEIGHT);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.#pixels);
    gl.getBufferSubData(gl.PIXEL_PACK_BUFFER, 0, found);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    gl.deleteBuffer(this.#pixels);
    this.#pixels = null;
    let shown = 0;
    for (let at = 3; at < found.length; at += 4) shown += found[at] === 255 ? 1 : 0;
    this.share = shown / (WIDTH * HEIGHT);
    this.picture = this.#reading;
  }
}
