// What a limit costs: the best objective for each value of it, each point to be tuned for.
import { element, shape } from "./dom.js";
import { format, tick } from "./numbers.js";

const WIDTH = 330, HEIGHT = 170, LEFT = 62, RIGHT = 14, TOP = 10, BOTTOM = 36, RADIUS = 4.5, FAR_APART = 10;

/** Places of values on an axis, logarithmic where they are far apart, and the texts at its ends. */
function axis(values, from, to) {
  let low = Math.min(...values), high = Math.max(...values);
  const logarithmic = low > 0 && high / low > FAR_APART, scale = logarithmic ? Math.log : (v) => v;
  if (low === high) [low, high] = [low - Math.abs(low) / 10 - 1e-12, high + Math.abs(high) / 10 + 1e-12];
  const middle = logarithmic ? Math.sqrt(low * high) : (low + high) / 2;
  const at = (v) => from + ((to - from) * (scale(v) - scale(low))) / (scale(high) - scale(low));
  return { at, ticks: [low, middle, high].map((v) => Number(v.toPrecision(3))) };
}

/** A picture of the front; `choose(value)` tunes with that value of the limit. */
export function frontChart({ limit, objective, points }, choose) {
  const found = points.filter(([, best]) => best !== null), lost = points.length - found.length;
  if (!found.length) return element("p", { class: "sub" }, `No value of ${limit} keeps all limits.`);
  const x = axis(found.map(([value]) => value), LEFT, WIDTH - RIGHT), y = axis(found.map(([, best]) => best), HEIGHT - BOTTOM, TOP);
  const svg = shape("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "front", role: "group", "aria-label": `${objective} against the limit of ${limit}: ${found.length} points` });
  for (const value of y.ticks) svg.append(shape("path", { class: "grid", d: `M${LEFT} ${y.at(value)}H${WIDTH - RIGHT}` }), shape("text", { x: LEFT - 8, y: y.at(value) + 4, class: "end" }, tick(value)));
  for (const value of x.ticks) svg.append(shape("text", { x: x.at(value), y: HEIGHT - BOTTOM + 18, class: "middle" }, tick(value)));
  svg.append(shape("text", { x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 4, class: "middle title" }, `limit of ${limit}`));
  svg.append(shape("path", { class: "line", d: found.map(([value, best], k) => `${k ? "L" : "M"}${x.at(value)} ${y.at(best)}`).join("") }));
  for (const [value, best] of found) {
    const text = `${limit} ${format(value)}: ${objective} about ${format(best)}. Tune for it`;
    const point = shape("circle", { cx: x.at(value), cy: y.at(best), r: RADIUS, tabindex: 0, role: "button", "aria-label": text }, shape("title", {}, text));
    point.addEventListener("click", () => choose(value));
    point.addEventListener("keydown", (event) => ["Enter", " "].includes(event.key) && (event.preventDefault(), choose(value)));
    svg.append(point);
  }
  const hint = `${objective} against ${limit}, by estimates; click a point to tune and certify for it${lost ? `. ${lost} further ${lost > 1 ? "values" : "value"} of the limit cannot be kept` : ""}.`;
  return element("figure", { class: "front-figure" }, svg, element("figcaption", { class: "sub" }, hint));
}
