"use strict";
// What the scripts of the pages share: each page that has a script has this one before it.
const byId = (id) => document.getElementById(id);

/** An SVG element with attributes and a text. */
const drawn = (name, values, text = "") => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(values)) element.setAttribute(key, value);
  element.textContent = text;
  return element;
};

/** Whether a key press may be a shortcut: without Ctrl and the like, and not in a field. */
const isShortcut = (event) =>
  !(event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, textarea, input[type='text']"));
