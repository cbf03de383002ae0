// Starts the page: finds the archive that the address or the host names, and exposes the page's state to programs.

import type { Vec3, WalkerRecording } from "slicewalk";
import { removeLeftovers } from "slicewalk/convert";
import { parseAddress, type Place } from "./address";
import { App } from "./app";
import type { Conversions } from "./conversions";
import { Kiosk, readKiosk } from "./kiosk";
import { readTable } from "./table";
import { chosenLanguage, texts } from "./languages";
import { h } from "./ui/dom";
import "./style.css";

declare global {
  interface Window {
    slicewalk?: {
      state(): Record<string, unknown>;
      /** Opens an archive or converts a scan; resolves when one can walk. Options are named as in Python. */
      open: Conversions["open"];
      /** The bytes of the open archive. */
      save(): Promise<Blob>;
      goto(place: { at?: Vec3; look?: readonly [number, number] }): Promise<void>;
      /** Records inputs and path of the pawn for tests and reports, to be replayed by the library. */
      record(): Promise<void>;
      recording(): Promise<WalkerRecording>;
    };
  }
}

function refuse(parent: HTMLElement): void {
  const { title, wayOut } = texts.errors.webgl;
  parent.append(h("main", { class: "refused" }, h("h1", {}, title), h("p", {}, wayOut)));
}

async function start(parent: HTMLElement): Promise<void> {
  document.documentElement.lang = chosenLanguage();
  parent.replaceChildren();
  let app: App;
  try {
    app = new App(parent);
  } catch {
    refuse(parent);
    return;
  }
  const walker = () => {
    if (app.session === null) throw new Error("no archive is open");
    return app.session.pawn.walker;
  };
  window.slicewalk = {
    state: () => app.state,
    open: (input, options) => app.conversions.open(input, options),
    save: () => app.conversions.save(),
    goto: (place) => app.goto(place),
    record: async () => walker().record(),
    recording: async () => walker().recording(),
  };
  const table = await readTable();
  const named = (): { place: Place; url: string | null } => {
    const place = parseAddress(location.search);
    return { place, url: place.archive ?? table.archives[0]?.url ?? null };
  };
  const { place, url } = named();
  const kiosk = await readKiosk(location.search, table, url);
  if (kiosk !== null) app.kiosk = new Kiosk(parent, kiosk, app.drive);
  app.offer(table, place.splats, url === null);
  window.addEventListener("popstate", () => {
    const { place, url } = named();
    if (url !== null) void app.visit(url, place);
  });
  const conversions = table.archives.filter((archive) => archive.converting !== undefined);
  const followed = conversions.map((archive) => ({ url: archive.url, done: app.conversions.follow(archive.converting ?? "") }));
  const awaited = followed.find((conversion) => conversion.url === url);
  if (url === null || (awaited !== undefined && !(await awaited.done))) return;
  await app.visit(url, place);
}

const parent = document.getElementById("app");
if (parent) void start(parent);
void removeLeftovers();
