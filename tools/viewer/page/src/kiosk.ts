// A page in a public place: large controls and no settings, back to the start when nobody touches it, a tour until somebody
// does; and the texts of a place from `settings.json` beside its archive.

import type { Vec3 } from "slicewalk";
import type { Mode } from "./address";
import { isNumbers, type Look } from "./geometry";
import { nothing, type Intent } from "./input/intent";
import { texts, translated } from "./languages";
import type { Arrival } from "./pawn";
import { h } from "./ui/dom";
import "./kiosk.css";

/** Distance from a stop within which its caption is shown, unless it names another (m). */
const NEAR_M = 3;
/** Pause at the end of a tour before it begins again, and at a place that cannot be reached (ms). */
const PAUSE_MS = 4_000;
const LOOK_MS = 250;
/** Time for which a control that is clicked without a pointer is held (ms). */
const CLICK_MS = 400;
/** Degrees that the eye turns at most towards the way, at once and for each look. */
const TURN_DEGREES = 12;
const MODES: readonly Mode[] = ["walk", "orbit", "plan"];

/** Contents of `settings.json`; texts are plain or by language. */
export interface PlaceSettings {
  readonly title?: unknown;
  readonly text?: unknown;
  /** View at the start: `at` (m), `look` (degrees), `view`. */
  readonly start?: { readonly at?: readonly number[]; readonly look?: readonly number[]; readonly view?: string };
  /** Views that visitors may choose. */
  readonly modes?: readonly string[];
  readonly stops?: readonly { readonly at?: readonly number[]; readonly caption?: unknown; readonly radius?: number }[];
}

/** The page, as far as a kiosk drives it. */
export interface Driven {
  readonly at: Vec3 | null;
  readonly look: Look | null;
  readonly mode: Mode;
  /** Whether the first view is shown. */
  readonly first: boolean;
  setMode(mode: Mode): void;
  /** Shows the first view. */
  frame(): void;
  goto(place: { at?: Vec3; look?: readonly [number, number] }): Promise<void>;
  /** Walks straight to a place; `arrived` is called at its end. */
  walkTo(place: Vec3, arrived: (how: Arrival) => void): void;
  stop(): void;
}

export interface KioskOptions {
  /** Address of the archive that they are about. */
  readonly archive: string | null;
  /** Idle time after which the page returns to its start (s); null: no kiosk, texts only. */
  readonly seconds: number | null;
  readonly tour: readonly Vec3[];
  readonly settings: PlaceSettings;
}

const isObject = (value: unknown): value is object => typeof value === "object" && value !== null;

const triple = (numbers: unknown): Vec3 | null => (isNumbers(numbers, 3) ? (numbers as Vec3) : null);

/** Reads what the address and the host's table ask for. */
export async function readKiosk(
  search: string,
  table: { readonly kiosk?: number; readonly tour?: string; readonly settings?: string },
  archive: string | null,
): Promise<KioskOptions | null> {
  const fields = new URLSearchParams(search);
  const given = fields.get("kiosk");
  const seconds = given === null ? (table.kiosk ?? null) : Number(given);
  const isKiosk = seconds !== null && Number.isFinite(seconds) && seconds > 0;
  const tourUrl = fields.get("tour") ?? table.tour ?? null;
  // Beside the archive; plain hosts are asked only where a kiosk stands, as they may not have such a file.
  const beside = isKiosk && archive !== null ? besideOf(archive) : null;
  const settingsUrl = fields.get("settings") ?? table.settings ?? beside;
  if (!isKiosk && tourUrl === null && settingsUrl === null) return null;
  const [settings, tour] = await Promise.all([readSettings(settingsUrl), readTour(tourUrl)]);
  return { archive, seconds: isKiosk ? seconds : null, tour, settings };
}

/** Address of the settings beside an archive; null if the archive's is none, which is reported when it is opened. */
function besideOf(archive: string): string | null {
  try {
    return new URL("settings.json", new URL(archive, location.href)).href;
  } catch {
    return null;
  }
}

async function readSettings(url: string | null): Promise<PlaceSettings> {
  if (url === null) return {};
  try {
    const answer = await fetch(url);
    const settings: unknown = answer.ok ? await answer.json() : {};
    if (!isObject(settings)) return {};
    const { stops } = settings as PlaceSettings;
    return { ...settings, stops: Array.isArray(stops) ? stops.filter(isObject) : [] };
  } catch {
    return {};
  }
}

/** Places of a table with the columns x, y and z. */
export async function readTour(url: string | null): Promise<Vec3[]> {
  if (url === null) return [];
  try {
    const answer = await fetch(url);
    return answer.ok ? parseTour(await answer.text()) : [];
  } catch {
    return [];
  }
}

export function parseTour(text: string): Vec3[] {
  const rows = text.split(/\r\n|\r|\n/).filter((row) => row.trim() !== "" && !row.startsWith("#"));
  // Cells may be quoted; numbers hold no commas.
  const cells = rows.map((row) =>
    row.split(",").map((cell) =>
      cell
        .trim()
        .replace(/^"(.*)"$/, "$1")
        .trim(),
    ),
  );
  const head = cells[0]?.map((name) => name.toLowerCase()) ?? [];
  const columns = ["x", "y", "z"].map((name) => head.indexOf(name));
  if (columns.includes(-1)) return [];
  return cells.slice(1).flatMap((row) => {
    const place = triple(
      columns.map((column) => (row[column] === undefined || row[column] === "" ? NaN : Number(row[column]))),
    );
    return place === null ? [] : [place];
  });
}

export class Kiosk {
  readonly #caption = h("p", { class: "caption", role: "status", "aria-live": "polite", hidden: true });
  readonly #hint = h("p", { class: "hint", hidden: true });
  readonly #held = nothing();
  readonly #modes = new Map<Mode, HTMLButtonElement>();
  readonly #title: string;
  #touched = performance.now();
  /** Whether nobody has touched it since it began or returned. */
  #rests = true;
  #home: { at: Vec3; look: readonly [number, number]; mode: Mode; first: boolean } | null = null;
  #next = -1;
  #resume = 0;

  constructor(
    parent: HTMLElement,
    readonly options: KioskOptions,
    readonly driven: Driven,
  ) {
    const { settings, seconds, tour } = options;
    const title = translated(settings.title);
    this.#title = title;
    const text = translated(settings.text);
    if (title !== "" || text !== "") {
      const head = h("div", { class: "place-texts" });
      if (title !== "") head.append(h("h1", {}, title));
      if (text !== "") head.append(h("p", {}, text));
      parent.append(head);
    }
    parent.append(this.#caption, this.#hint);
    if (seconds !== null) {
      parent.classList.add("kiosk");
      parent.append(this.#controls());
    }
    this.#hint.textContent = texts.kiosk.touch;
    for (const event of ["pointerdown", "keydown", "wheel", "touchstart"]) {
      window.addEventListener(event, () => this.touch(), { capture: true, passive: true });
    }
    // A mouse that rests may be reported, too, when something moves below it.
    const moved = ({ pointerType, movementX, movementY }: PointerEvent): void => {
      if (pointerType !== "mouse" || movementX !== 0 || movementY !== 0) this.touch();
    };
    window.addEventListener("pointermove", moved, { capture: true, passive: true });
    if (seconds !== null || tour.length > 0 || (settings.stops?.length ?? 0) > 0) {
      window.setInterval(() => this.#look(), LOOK_MS);
    }
  }

  /** State for programs. */
  get state(): Record<string, unknown> {
    const idle = (performance.now() - this.#touched) / 1000;
    return {
      seconds: this.options.seconds,
      idle,
      touring: this.#next >= 0,
      stop: this.#next,
      caption: this.#caption.hidden ? null : this.#caption.textContent,
    };
  }

  /** Controls that are held down. */
  get intent(): Intent {
    return { ...this.#held };
  }

  /** Whether it is a kiosk, not only texts of a place or a tour. */
  get isKiosk(): boolean {
    return this.options.seconds !== null;
  }

  /** Whether a visitor may choose a view. */
  permits(mode: Mode): boolean {
    return !this.isKiosk || this.modes.includes(mode);
  }

  /** Called when an archive is open: remembers where the page begins, and starts the tour. */
  async opened(link: string | null): Promise<void> {
    if (link === null || link !== this.options.archive) return;
    if (this.#title !== "") document.title = this.#title;
    const { start } = this.options.settings;
    const at = triple(start?.at);
    const look = start?.look;
    const isLook = isNumbers(look, 2);
    const place = { ...(at && { at }), ...(isLook && { look: look as unknown as [number, number] }) };
    if (at !== null || isLook) await this.driven.goto(place).catch(() => {});
    const mode = MODES.find((mode) => mode === start?.view) ?? this.driven.mode;
    if (mode !== this.driven.mode) this.driven.setMode(mode);
    const { at: now, look: looked } = this.driven;
    if (now !== null && looked !== null) {
      this.#home = { at: now, look: [looked.heading, looked.pitch], mode, first: this.driven.first };
    }
    if (this.options.tour.length > 0) this.#begin();
  }

  /** Views that visitors may choose. */
  get modes(): readonly Mode[] {
    const { modes } = this.options.settings;
    const permitted = Array.isArray(modes) ? MODES.filter((mode) => modes.includes(mode)) : MODES;
    return permitted.length > 0 ? permitted : ["walk"];
  }

  #controls(): HTMLElement {
    const { label, forward, back, left, right, home, modes } = texts.kiosk;
    const hold = (name: string, sign: string, key: "forward" | "turn", value: number): HTMLElement => {
      const button = h("button", { type: "button", "aria-label": name, title: name }, sign);
      const set =
        (held: boolean) =>
        (event: Event): void => {
          event.preventDefault();
          this.#held[key] = held ? value : 0;
        };
      button.addEventListener("pointerdown", set(true));
      button.addEventListener("keydown", (event) => {
        if (event.code === "Space" || event.code === "Enter") set(true)(event);
      });
      const ends = ["pointerup", "pointercancel", "pointerleave", "keyup", "blur"];
      for (const end of ends) button.addEventListener(end, set(false));
      // Switches and voices only click.
      button.addEventListener("click", (event) => {
        if (event.detail > 0) return;
        set(true)(event);
        window.setTimeout(() => set(false)(event), CLICK_MS);
      });
      button.addEventListener("contextmenu", (event) => event.preventDefault());
      return button;
    };
    const steps = h(
      "div",
      { class: "steps" },
      hold(left, "↺", "turn", -1),
      hold(forward, "↑", "forward", 1),
      hold(right, "↻", "turn", 1),
      hold(back, "↓", "forward", -1),
    );
    const others = h("div", { class: "others" });
    if (this.modes.length > 1) {
      for (const mode of this.modes) {
        const button = h("button", { type: "button", onclick: () => this.driven.setMode(mode) }, modes[mode]);
        this.#modes.set(mode, button);
        others.append(button);
      }
    }
    others.append(h("button", { type: "button", class: "home", onclick: () => void this.#return(false) }, home));
    return h("div", { class: "kiosk-controls", role: "group", "aria-label": label }, steps, others);
  }

  #show(): void {
    this.#modes.forEach((button, mode) => button.setAttribute("aria-pressed", String(mode === this.driven.mode)));
  }

  /** Somebody is there. */
  touch(): void {
    this.#touched = performance.now();
    this.#rests = false;
    if (this.#next < 0) return;
    this.#next = -1;
    this.driven.stop();
    this.#hint.hidden = true;
  }

  /** Goes back to the start; if nobody asked for it, until somebody comes. */
  async #return(isIdle: boolean): Promise<void> {
    const home = this.#home;
    if (home === null) return;
    this.driven.stop();
    // Who only turned the scan has not left its first view.
    const isThere = home.first && this.driven.first;
    if (!isThere) await this.driven.goto({ at: home.at, look: home.look }).catch(() => {});
    if (isIdle && !this.#rests) return;
    if (home.first) this.driven.frame();
    else this.driven.setMode(home.mode);
  }

  /** Looks after idle time, tour, captions and the view that is marked. */
  #look(): void {
    const now = performance.now();
    const { seconds, tour } = this.options;
    const isIdle = seconds !== null && this.#next < 0 && now - this.#touched > 1000 * seconds;
    if (isIdle && !this.#rests && this.#home !== null) {
      this.#rests = true;
      void this.#return(true).then(() => {
        if (tour.length > 0 && this.#rests) this.#begin();
      });
    }
    if (this.#next >= 0 && this.#resume > 0 && now > this.#resume) this.#walk();
    if (this.#next >= 0 && this.#resume === 0) this.#face();
    this.#explain();
    this.#show();
  }

  #begin(): void {
    this.#next = 0;
    this.#hint.hidden = false;
    this.driven.setMode("walk");
    this.#resume = performance.now();
  }

  /** Goes on to the next place of the tour; after the last one from the first. */
  #walk(): void {
    this.#resume = 0;
    const place = this.options.tour[this.#next];
    if (place === undefined) {
      this.#next = 0;
      const first = this.options.tour[0];
      if (first !== undefined) void this.driven.goto({ at: first }).catch(() => {});
      this.#resume = performance.now() + PAUSE_MS;
      return;
    }
    this.driven.walkTo(place, (how) => {
      if (this.#next < 0) return;
      // A place that cannot be walked to is begun from, so that a tour never stands still.
      if (how === "gave-up") void this.driven.goto({ at: place }).catch(() => {});
      this.#next += 1;
      const rests = how === "gave-up" || this.#next >= this.options.tour.length;
      this.#resume = performance.now() + (rests ? PAUSE_MS : 1);
      if (!rests) this.#walk();
    });
  }

  /** Turns the eye towards the next place. */
  #face(): void {
    const { at, look } = this.driven;
    const place = this.options.tour[this.#next];
    if (at === null || look === null || place === undefined) return;
    const [east, north] = [place[0] - at[0], place[1] - at[1]];
    if (Math.hypot(east, north) < 0.3) return;
    const heading = (Math.atan2(east, north) * 180) / Math.PI;
    const turn = ((((heading - look.heading) % 360) + 540) % 360) - 180;
    look.heading += Math.max(-TURN_DEGREES, Math.min(TURN_DEGREES, turn));
    look.pitch *= 0.8;
  }

  /** Shows the caption of the nearest stop. */
  #explain(): void {
    const { at } = this.driven;
    let [best, words] = [Infinity, ""];
    for (const { at: place, caption, radius = NEAR_M } of this.options.settings.stops ?? []) {
      const there = triple(place);
      if (there === null || at === null) continue;
      const far = Math.hypot(there[0] - at[0], there[1] - at[1], there[2] - at[2]);
      if (far <= radius && far < best) [best, words] = [far, translated(caption)];
    }
    this.#caption.hidden = words === "";
    if (this.#caption.textContent !== words) this.#caption.textContent = words;
  }
}
