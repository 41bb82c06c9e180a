"use strict";
// Functions that the scripts of the pages share. Pages include this script before the others.
const byId = (id) => document.getElementById(id);

/** Make an SVG element with attributes and a text. */
const drawn = (name, values, text = "") => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(values)) element.setAttribute(key, value);
  element.textContent = text;
  return element;
};

/** Return whether a key press may be a shortcut: it has no modifier such as Ctrl, and the focus is not in a field. */
const isShortcut = (event) =>
  !(event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, textarea, input[type='text']"));
