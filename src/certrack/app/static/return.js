// A page that is loaded again, or opened by a link, knows its key though the address bar does not show it.
const DESIGN = /^#design=/, keys = [sessionStorage, localStorage].map((store) => store.getItem("certrack-key"));
const key = keys.find(Boolean), asked = new URLSearchParams(location.search).get("t");
if (DESIGN.test(location.hash)) localStorage.setItem("certrack-linked", location.hash);
if (key && key !== asked) location.replace(`/?t=${encodeURIComponent(key)}${location.hash}`);
else if (DESIGN.test(location.hash)) document.getElementById("linked").hidden = false;
