// The tabs of the left column, as screen readers and keys know them.
import { byId } from "./dom.js";

const tabs = () => [...document.querySelectorAll("[role=tab]")];

/** Show a tab; `shown` is called with its name. */
export function select(name, shown) {
  for (const tab of tabs()) {
    const chosen = tab.id === `tab-${name}`;
    tab.setAttribute("aria-selected", String(chosen));
    tab.tabIndex = chosen ? 0 : -1;
    byId(tab.getAttribute("aria-controls")).hidden = !chosen;
  }
  shown(name);
}

export function bindTabs(shown) {
  for (const tab of tabs()) {
    tab.onclick = () => select(tab.id.replace("tab-", ""), shown);
    tab.onkeydown = (event) => {
      const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (!by) return;
      const all = tabs(), next = all.at((all.indexOf(tab) + by) % all.length);
      next.click();
      next.focus();
    };
  }
}
