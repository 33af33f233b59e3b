// A page that is loaded again knows its key, though the address bar does not show it.
const key = sessionStorage.getItem("certrack-key");
if (key && !new URLSearchParams(location.search).has("t")) {
  location.replace(`/?t=${encodeURIComponent(key)}${location.hash}`);
}
