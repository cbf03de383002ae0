// The language of the page: of the address (`lang=de`), else of the browser, else English.

import { de } from "./de";
import { en, type Texts } from "./en";
import { es } from "./es";
import { fr } from "./fr";
import { pt } from "./pt";

const LANGUAGES: Readonly<Record<string, Texts>> = { en, de, fr, es, pt };

export function chosenLanguage(search: string = location.search): string {
  const asked = new URLSearchParams(search).get("lang");
  const all = [...(asked === null ? [] : [asked]), ...(asked === null ? navigator.languages : [])];
  return all.map((name) => name.slice(0, 2).toLowerCase()).find((name) => name in LANGUAGES) ?? "en";
}

/** The texts of the page. */
export const texts: Texts = LANGUAGES[chosenLanguage()] ?? en;

/** The text in this language of an object such as `{"en": "…", "de": "…"}`, or a plain text. */
export function translated(text: unknown, language = chosenLanguage()): string {
  if (typeof text === "string") return text;
  if (typeof text !== "object" || text === null) return "";
  const all = text as Record<string, unknown>;
  const found = all[language] ?? all["en"] ?? Object.values(all)[0];
  return typeof found === "string" ? found : "";
}
