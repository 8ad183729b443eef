// Coordinates of the service, which are in the project's unit and the axes of its frame: in metres
// and in the plane of drawings (east, north, up), which the summary gives.
import { fixed, isNumber, t } from "./language.js";
import { context, here, peek } from "./live.js";

const AXES = ["x", "y", "z"];
const ALONG = 1e-9; // cosine below which an axis does not contribute
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

// East, north, up of a vector of the frame. A component to which a coordinate contributes that is not
// compared is null: it is unknown, not zero.
export function turned(vector) {
  const plane = summary()?.plane;
  if (!plane) return [null, null, null];
  const known = vector.map((v) => (isNumber(v) ? v : 0));
  return plane.axes.map((row) => (row.some((r, i) => Math.abs(r) > ALONG && !isNumber(vector[i])) ? null : turn([row], known)[0]));
}

// σ of the part in height of such a vector from those of its components; where several contribute,
// whose correlation is not known, the largest that it can be.
export const sigmaUp = (sigmas) => {
  const row = summary()?.plane?.axes[2] ?? [];
  return row.reduce((sum, r, i) => sum + (Math.abs(r) > ALONG ? Math.abs(r) * sigmas[i] : 0), 0) || NaN;
};

// Where an axis of the frame points: east, south … up, or none of them, as in geocentric frames.
function direction(i) {
  const plane = summary()?.plane;
  const along = plane?.axes.findIndex((row) => Math.abs(Math.abs(row[i]) - 1) < ALONG) ?? -1;
  return along < 0 ? null : t((plane.axes[along][i] > 0 ? ["east", "north", "up"] : ["west", "south", "down"])[along]);
}
export const axisName = (a) => {
  const to = direction(AXES.indexOf(a));
  return to ? `${a}, ${to}` : a;
};
// In which axes the figures of a view are, where the plan is drawn in east, north and up.
export const axesNote = () => (summary()?.plane
  ? AXES.every((_, i) => direction(i)) ? t("axes_named", { axes: AXES.map((a) => axisName(a).replace(",", "")).join(", ") }) : t("axes_turned")
  : "");
