// Coordinates of the service, which are in the project's unit and the axes of its frame: in metres
// and in the plane of drawings (east, north, up), which the summary gives.
import { fixed, isNumber } from "./language.js";
import { context, here, peek } from "./live.js";

const AXES = ["x", "y", "z"];
const summary = () => peek(here("")) ?? context.summary;

// Unit of coordinates and its size in metres; unknown, they make no figure.
export const lengthUnit = () => summary()?.units?.length ?? "?";
export const metresOfUnit = () => summary()?.length_m ?? NaN;
// A coordinate to a tenth of a millimetre.
export const coordinate = (v) => fixed(v, Math.max(Math.round(4 + Math.log10(metresOfUnit() || 1)), 0));

const turn = (axes, v) => axes.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);

// East, north, up of a place, metres; null where it has none.
export function placed(p) {
  const plane = summary()?.plane, size = metresOfUnit();
  if (!plane || !AXES.every((a) => isNumber(p[a]))) return null;
  return turn(plane.axes, AXES.map((a, i) => p[a] * size - plane.origin[i]));
}

// East, north, up of a vector of the frame; coordinates that are not compared count as zero.
export function turned(vector) {
  const plane = summary()?.plane;
  return plane ? turn(plane.axes, vector.map((v) => (isNumber(v) ? v : 0))) : [NaN, NaN, NaN];
}
