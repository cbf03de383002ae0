/** Moves along surfaces, as numbers. */

import { count, number, object, optional, place, refused, shown } from "./check.js";
import { CONTACT_LENGTH, readContact, readSlide, SLIDE_LENGTH } from "./messages.js";
import type { Sliding } from "./protocol.js";
import type { Contact, PlacedShape, Slide, SlideOptions, Vec3 } from "./types.js";

/** Most contacts unless the caller says otherwise. */
const CONTACTS = 4;

function shapeNumbers(given: PlacedShape): Float64Array {
  const shape = object(given, "a shape");
  if ("min" in shape) {
    return Float64Array.of(...place(shape.min, "a corner of a box"), ...place(shape.max, "a corner of a box"));
  }
  const [x, y, z] = place(shape.at, "the place of a shape");
  switch (shape.shape) {
    case "sphere":
      return Float64Array.of(x, y, z, number(shape.radius, "shape.radius"));
    case "cylinder":
      return Float64Array.of(x, y, z, number(shape.radius, "shape.radius"), number(shape.height, "shape.height"));
    case "box": {
      const [halfX, halfY] = [number(shape.x, "shape.x") / 2, number(shape.y, "shape.y") / 2];
      return Float64Array.of(x - halfX, y - halfY, z, x + halfX, y + halfY, z + number(shape.height, "shape.height"));
    }
    default:
      throw refused(`a shape is a box, a cylinder or a sphere, found ${shown((shape as { shape?: unknown }).shape)}`);
  }
}

export function toSliding(shape: PlacedShape, motion: Vec3, options?: SlideOptions): Sliding {
  const { iterations = CONTACTS } = optional(options);
  const contacts = count(iterations, "iterations");
  return { shape: shapeNumbers(shape), motion: Float64Array.from(place(motion, "a move")), contacts };
}

export function toSlide(numbers: Float64Array): Slide {
  const { x, y, z, missing } = readSlide(numbers);
  const contacts: Contact[] = [];
  for (let at = SLIDE_LENGTH; at < numbers.length; at += CONTACT_LENGTH) {
    const { distance, normalX, normalY, normalZ, obstacle } = readContact(numbers, at);
    contacts.push({ distance, normal: [normalX, normalY, normalZ], obstacle: obstacle !== 0 });
  }
  return { motion: [x, y, z], contacts, missing: missing !== 0 };
}
