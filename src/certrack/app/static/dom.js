// Small helpers for elements. Texts enter the page as texts only.

export const byId = (id) => document.getElementById(id);

/** An element with attributes, and children that are elements or texts. */
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name === "class") made.className = value;
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

const SVG = "http://www.w3.org/2000/svg";

/** A part of a drawing, with children that are parts or texts. */
export function shape(tag, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

/** A drawing of 12 or 16 units; the paths are our own. */
export const drawing = (size, ...paths) => shape("svg", { viewBox: `0 0 ${size} ${size}`, "aria-hidden": "true" }, ...paths.map((d) => shape("path", { d })));

/** A press there begins a gesture of ours: the browser neither selects text nor drags it away. */
export const ownGesture = (target) => target.addEventListener("mousedown", (event) => event.preventDefault());

/** Set a text if it differs: the layout is left alone where nothing changes. */
export function write(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

/** Set a class name if it differs. */
export function style(target, name) {
  if (target.className !== name) target.className = name;
}

/** Set an attribute if it differs. */
export function attribute(target, name, value) {
  if (target.getAttribute(name) !== String(value)) target.setAttribute(name, value);
}

/** A colour or length of the theme. */
export const token = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Call `work` at once if it is urgent or was not called for `interval` ms; else that long after it is asked for last. */
export function spaced(work, interval) {
  let timer, last = -Infinity;
  const now = () => {
    last = performance.now();
    work();
  };
  return (urgent) => {
    clearTimeout(timer);
    if (urgent || performance.now() - last >= interval) now();
    else timer = setTimeout(now, interval);
  };
}

/** Call `work` once, `delay` ms after the last call. */
export function settled(work, delay) {
  let timer;
  return (...values) => {
    clearTimeout(timer);
    timer = setTimeout(() => work(...values), delay);
  };
}
