// Files that a person drops or chooses, or that a program opens: archives are opened, scans and meshes are converted in this
// browser first. Whatever fails, the open scene stays.

import { SlicewalkError, type Archive } from "slicewalk";
import { ConversionError, Converter, mainOf, type ConversionOptions, type Converted } from "slicewalk/convert";
import { chosenLanguage, texts } from "./languages";
import { UPS } from "./scene/alignment";
import { fromAddress, type Source } from "./session";
import { saveAs } from "./share";
import { h } from "./ui/dom";
import "./conversions.css";

/** First bytes of archives of this and of older drafts. */
const MAGICS = ["\x89SLA\r\n\x1a\n", "\x89SLIC\r\n\x1a"];
/** Options of a conversion for the eye, unless others are given: those of `slicetool serve`. */
const USUAL: ConversionOptions = { colour: "auto", levels: true };
/** Interval at which the page asks for the state of a conversion by the server (ms). */
const ASK_MS = 250;
/** Time without an answer after which the server counts as gone (ms). */
const GONE_MS = 5_000;

export interface Converting {
  readonly stage: string;
  readonly share: number;
}

/** The page, as far as it opens and shows. */
export interface Opener {
  /** Opens an archive; resolves to null, or to the reason why it is not open, which the page shows. */
  open(source: Source): Promise<SlicewalkError | null>;
  /** The scan at an address, null for an archive; fails with `aborted` if something else is chosen meanwhile. */
  fetch(source: Source): Promise<File | null>;
  /** The open archive and its source. */
  readonly archive: Archive | null;
  readonly source: Source | null;
  say(text: string): void;
}

type Units = "m" | "ft" | "us-ft" | "cm" | "mm";
/** What the form asks for, as errors of the conversion name it. */
const ASKED = ["PixelSize", "AutomaticPixelSize", "Units", 'Other("up")'];
const FACTORS: Readonly<Partial<Record<Units, number>>> = { cm: 0.01, mm: 0.001 };

/** Stated facts of the files, as `sliceconv --dry-run --json` names them. */
interface Facts {
  points_stated?: number;
  extent?: readonly number[] | null;
  crs?: string | null;
  unit?: { name: string } | null;
  /** False where the unit is assumed. */
  unit_stated?: boolean;
  inputs?: readonly { points_stated: number | null }[];
}

const grouped = (number: number): string => number.toLocaleString(chosenLanguage());
const size = (bytes: number): string => (bytes < 1e6 ? `${Math.ceil(bytes / 1e3)} kB` : `${(bytes / 1e6).toFixed(1)} MB`);
const named = (files: readonly File[]): string => mainOf(files)?.name ?? "";

export class Conversions {
  readonly #bar = h("progress", { max: 1 });
  readonly #words = h("span", { role: "status", "aria-live": "polite" });
  readonly #working: HTMLElement;
  readonly #dialog = h("dialog", { class: "conversion", "aria-labelledby": "conversion-title" });
  readonly #made = h("aside", { class: "made", hidden: true });
  #running: Converter | null = null;
  #now: Converting | null = null;
  /** The open archive, if it was converted here. */
  #converted: Converted | null = null;
  /** Reads the files that the form asks about. */
  #asking: Converter | null = null;
  /** The reason why the last archive did not open. */
  #shown: SlicewalkError | null = null;

  constructor(
    parent: HTMLElement,
    foot: HTMLElement,
    readonly opener: Opener,
    readonly chooseOther: () => void,
  ) {
    const { convert } = texts;
    const cancel = h("button", { type: "button", class: "plain", onclick: () => this.cancel() }, convert.cancel);
    const quiet = h("small", { class: "quiet" }, convert.privacy);
    this.#working = h("div", { class: "converting", hidden: true }, this.#words, this.#bar, quiet, cancel);
    this.#dialog.addEventListener("close", () => this.#offer());
    parent.append(this.#dialog);
    foot.prepend(this.#working, this.#made);
  }

  /** What a conversion does now; null if there is none. */
  get converting(): Converting | null {
    return this.#now;
  }

  /** Opens what a person dropped or chose: asks first how a scan is to be read. */
  async take(files: readonly File[]): Promise<void> {
    const [first] = files;
    if (first === undefined) return;
    let takesArchive: boolean;
    try {
      takesArchive = await holdArchive(files);
    } catch (error) {
      this.#trouble(texts.convert.failed, error instanceof Error ? error.message : String(error), null);
      return;
    }
    if (takesArchive) await this.opener.open({ archive: first, link: null, name: first.name });
    else await this.#ask(files, {});
  }

  /** Opens an archive, or converts a scan; resolves when one can walk in it, or rejects with the reason why not. */
  async open(input: File | readonly File[] | URL | string, options: ConversionOptions = {}): Promise<void> {
    if (typeof input === "string" || input instanceof URL) {
      const source = fromAddress(String(input));
      const scan = await this.opener.fetch(source);
      if (scan === null) await this.#walkIn(source);
      else await this.#convert([scan], options);
      return;
    }
    // Programs may give anything.
    const list: Iterable<File> = input instanceof Blob ? [input] : input;
    const files: File[] = typeof list === "object" && list !== null && Symbol.iterator in list ? [...list] : [];
    const [first] = files;
    if (first === undefined || !files.every((file) => file instanceof Blob)) {
      throw new SlicewalkError("invalid", "expected a File, several files, or an address");
    }
    const name = first.name ?? "scan";
    if (await holdArchive(files)) await this.#walkIn({ archive: first, link: null, name });
    else await this.#convert(files, options);
  }

  /** The bytes of the open archive. */
  async save(): Promise<Blob> {
    const { source, archive } = this.opener;
    if (source === null || archive === null) throw new SlicewalkError("invalid", "no archive is open");
    return source.archive instanceof Blob ? source.archive : archive.file();
  }

  /** Saves the open archive as a file. */
  async download(): Promise<void> {
    const source = this.opener.source;
    if (source === null) {
      this.opener.say(texts.convert.nothing);
      return;
    }
    try {
      saveAs(await this.save(), source.name);
    } catch (error) {
      this.opener.say(error instanceof Error ? error.message : String(error));
    }
  }

  /** Ends the conversion that runs. */
  cancel(): void {
    this.#running?.close();
  }

  /** Shows the conversion that the server makes, and resolves to whether it came to its end. */
  async follow(url: string): Promise<boolean> {
    let heard = performance.now();
    for (;;) {
      try {
        const answer = await fetch(url, { cache: "no-store" });
        const state = (await answer.json()) as { converting: Converting | null; error: string | null };
        heard = performance.now();
        if (state.error !== null) {
          this.#show(null);
          this.#trouble(texts.convert.served, state.error, null);
          return false;
        }
        this.#show(state.converting, false);
        if (state.converting === null) return true;
      } catch {
        if (performance.now() - heard > GONE_MS) {
          this.#show(null);
          this.#trouble(texts.convert.served, texts.convert.gone, null);
          return false;
        }
      }
      await new Promise((resolve) => setTimeout(resolve, ASK_MS));
    }
  }

  /** Called when an archive is open: forgets the one before, if that was converted here. */
  entered(source: Source): void {
    this.#hide();
    if (this.#converted?.archive === source.archive) return;
    this.#converted?.release();
    this.#converted = null;
  }

  // Conversion -------------------------------------------------------------------------------------------------------------------

  async #convert(files: readonly File[], options: ConversionOptions): Promise<void> {
    if (this.#running !== null) throw new ConversionError("invalid", "another conversion runs; cancel it first");
    const converter = new Converter(files);
    this.#running = converter;
    let converted: Converted;
    try {
      converted = await converter.convert({ ...USUAL, ...options }, (now) => this.#show(now));
    } finally {
      this.#running = null;
      converter.close();
      this.#show(null);
    }
    const { archive } = converted;
    try {
      await this.#walkIn({ archive, link: null, name: archive.name });
    } catch (error) {
      converted.release();
      throw error;
    }
    this.#converted = converted;
    const { convert } = texts;
    const save = h("button", { type: "button", class: "primary", onclick: () => void this.download() }, convert.save);
    const hide = h("button", { type: "button", class: "plain", "aria-label": "×", onclick: () => this.#hide() }, "×");
    const lines = converted.warnings.map((warning) => h("li", {}, warning));
    const warnings = h("details", { hidden: lines.length === 0 }, h("summary", {}, convert.warnings), h("ul", {}, ...lines));
    this.#made.replaceChildren(h("span", {}, `${convert.done(archive.name)} ${convert.privacy}`), warnings, save, hide);
    this.#made.hidden = false;
  }

  #hide(): void {
    this.#made.hidden = true;
  }

  async #walkIn(source: Source): Promise<void> {
    this.#shown = await this.opener.open(source);
    if (this.#shown !== null) throw this.#shown;
  }

  #show(now: Converting | null, canCancel = true): void {
    this.#now = now;
    this.#working.hidden = now === null;
    const button = this.#working.lastElementChild;
    if (button instanceof HTMLElement) button.hidden = !canCancel;
    if (now === null) return;
    const percent = Math.floor(100 * now.share);
    const words = texts.convert.progress(texts.stages[now.stage] ?? now.stage, percent);
    if (this.#words.textContent !== words) this.#words.textContent = words;
    if (now.share > 0) this.#bar.value = now.share;
    else this.#bar.removeAttribute("value");
  }

  // Questions --------------------------------------------------------------------------------------------------------------------

  /** Shows what the files are, and converts them once a person agrees. */
  async #ask(files: readonly File[], options: ConversionOptions): Promise<void> {
    const { convert } = texts;
    this.#asking?.close();
    const converter = new Converter(files);
    this.#asking = converter;
    const cancel = h("button", { type: "button", class: "plain", onclick: () => this.#dialog.close() }, convert.cancel);
    this.#fill(convert.title(named(files)), h("p", {}, convert.reading(named(files))), cancel);
    // The event of an earlier close may come when the dialog is open again.
    const ended = (): void => {
      if (this.#dialog.open) return;
      this.#dialog.removeEventListener("close", ended);
      converter.close();
    };
    this.#dialog.addEventListener("close", ended);
    let facts: Facts;
    try {
      facts = await converter.preview(options);
    } catch (error) {
      if (error instanceof SlicewalkError && error.kind === "aborted") return;
      this.#refused(error, this.#remedy(error, files, options, []));
      return;
    }
    // Closed, or other files were chosen meanwhile.
    if (!this.#dialog.open || this.#asking !== converter) return;
    const unit = h("select", { id: "conversion-unit" });
    const isStated = facts.unit_stated === true && facts.unit != null;
    const stated = isStated ? convert.unitAuto(facts.unit?.name ?? "") : convert.unitUnknown;
    for (const [value, words] of [["auto", stated], ...Object.entries(convert.units)] as [string, string][]) {
      unit.append(h("option", { value }, words));
    }
    const up = h("select", { id: "conversion-up" });
    up.append(...UPS.map((axis) => h("option", { value: axis }, texts.overlays.ups[axis])));
    const pixel = h("input", {
      id: "conversion-pixel",
      type: "text",
      inputmode: "decimal",
      placeholder: convert.pixelAuto,
      pattern: "[0-9]*[.,]?[0-9]*",
    });
    const bytes = files.reduce((sum, file) => sum + file.size, 0);
    const points = facts.inputs?.some((input) => input.points_stated !== null)
      ? grouped(facts.points_stated ?? 0)
      : convert.mesh;
    const extent = facts.extent ? `${facts.extent.map((metres) => metres.toFixed(1)).join(" × ")} m` : convert.unknown;
    const crs = facts.crs ? (/"([^"]+)"/.exec(facts.crs)?.[1] ?? facts.crs.slice(0, 60)) : convert.unknown;
    const rows: readonly [string, string | HTMLElement][] = [
      [convert.files, `${files.length === 1 ? named(files) : `${files.length}`}, ${size(bytes)}`],
      [convert.points, points],
      [convert.extent, extent],
      [convert.crs, crs],
      [convert.unit, unit],
      [convert.up, up],
      [convert.pixel, pixel],
    ];
    const list = h("dl");
    for (const [name, value] of rows) {
      const label = value instanceof HTMLElement ? h("label", { for: value.id }, name) : name;
      list.append(h("div", {}, h("dt", {}, label), h("dd", {}, value)));
    }
    const form = h("form", {
      onsubmit: (event) => {
        event.preventDefault();
        const edge = Number(pixel.value.replace(",", "."));
        const chosen: Record<string, unknown> = { ...options, up: up.value };
        if (unit.value !== "auto") chosen["units"] = FACTORS[unit.value as Units] ?? unit.value;
        else if (!isStated) chosen["units"] = "m";
        if (edge > 0) chosen["pixel"] = edge;
        this.#dialog.close();
        this.#convert(files, chosen).catch((error: unknown) =>
          this.#refused(error, this.#remedy(error, files, options, ASKED)),
        );
      },
    });
    const start = h("button", { class: "primary" }, convert.start);
    form.append(list, h("p", { class: "quiet" }, convert.privacy), h("div", { class: "actions" }, start, cancel));
    this.#fill(convert.title(named(files)), h("p", {}, convert.lead), form);
    start.focus();
  }

  /** A button that asks about the files again, if another answer would help. */
  #remedy(error: unknown, files: readonly File[], options: ConversionOptions, asked: readonly string[]): HTMLElement | null {
    const parameter = error instanceof ConversionError ? (error.parameter ?? "") : "";
    const { change, partly } = texts.convert;
    const again = (words: string, other: ConversionOptions): HTMLElement =>
      h("button", { type: "button", class: "primary", onclick: () => void this.#ask(files, other) }, words);
    if (parameter === "Incomplete") return again(partly, { ...options, allow_incomplete: true });
    return asked.includes(parameter) ? again(change, options) : null;
  }

  /** Says why files were not converted, and offers the remedy; the open scene stays. */
  #refused(error: unknown, remedy: HTMLElement | null): void {
    const { convert } = texts;
    // The page shows already why the archive did not open.
    if (error === this.#shown) return;
    if (error instanceof SlicewalkError && error.kind === "aborted") {
      this.opener.say(convert.cancelled);
      this.#offer();
      return;
    }
    const message = error instanceof Error ? error.message : String(error);
    const isFull = /space|storage full|no storage/i.test(message);
    this.#trouble(convert.failed, message, isFull ? convert.full : null, remedy);
  }

  #trouble(title: string, detail: string, wayOut: string | null, remedy: HTMLElement | null = null): void {
    const { convert } = texts;
    const other = (): void => {
      this.#dialog.close();
      this.chooseOther();
    };
    const close = h("button", { type: "button", class: "plain", onclick: () => this.#dialog.close() }, convert.cancel);
    const again = h("button", { type: "button", class: remedy ? "plain" : "primary", onclick: other }, convert.again);
    const detailText = h("p", { class: "detail" }, detail);
    const more = wayOut === null ? [] : [h("p", {}, wayOut)];
    this.#fill(title, detailText, ...more, h("div", { class: "actions" }, ...(remedy ? [remedy] : []), again, close));
  }

  /** Offers a choice where nothing else can be acted on: no scan, no question and no conversion. */
  #offer(): void {
    if (!this.#dialog.open && this.#running === null && this.opener.source === null) this.chooseOther();
  }

  #fill(title: string, ...content: readonly Node[]): void {
    this.#dialog.replaceChildren(h("h2", { id: "conversion-title" }, title), ...content);
    if (!this.#dialog.open) this.#dialog.showModal();
  }
}

/** Whether files are an archive. Scans are converted together, but archives are opened one at a time. */
async function holdArchive(files: readonly File[]): Promise<boolean> {
  const { oneArchive, unreadable } = texts.convert;
  for (const file of files) {
    const is = await isArchive(file).catch((cause: unknown) => {
      throw new SlicewalkError("invalid", unreadable(file.name), { cause });
    });
    if (is && files.length > 1) throw new SlicewalkError("invalid", oneArchive(file.name));
    if (is) return true;
  }
  return false;
}

async function isArchive(file: Blob & { name?: string }): Promise<boolean> {
  if (/\.slices$/i.test(file.name ?? "")) return true;
  return hasMagic(new Uint8Array(await file.slice(0, 8).arrayBuffer()));
}

function hasMagic(bytes: Uint8Array): boolean {
  const start = String.fromCharCode(...bytes.subarray(0, 8));
  return MAGICS.some((magic) => start.startsWith(magic));
}

/** The scan at an address as a file; null for an archive, which is read by ranges. Fails with `aborted` by the signal. */
export async function fetchScan(source: Source, signal: AbortSignal): Promise<File | null> {
  const url = String(source.archive);
  if (/\.slices$/i.test(new URL(url).pathname)) return null;
  const ask = async (how: RequestInit): Promise<Response> => {
    const answer = await fetch(url, how);
    if (!answer.ok) throw new SlicewalkError("network", `${url}: the host answered ${answer.status}`);
    return answer;
  };
  try {
    const stop = new AbortController();
    const answer = await ask({ headers: { Range: "bytes=0-7" }, signal: AbortSignal.any([signal, stop.signal]) });
    const reader = answer.body?.getReader();
    const first = (await reader?.read())?.value ?? new Uint8Array();
    stop.abort();
    if (hasMagic(first)) return null;
    const whole = await ask({ signal });
    return new File([await whole.blob()], source.name);
  } catch (cause) {
    if (signal.aborted) throw new SlicewalkError("aborted", `${url}: something else was chosen meanwhile`, { cause });
    if (cause instanceof SlicewalkError) throw cause;
    throw new SlicewalkError("network", `${url}: the host does not answer`, { cause });
  }
}
