// Storage of the browser. If it is blocked or full, a value lasts as long as the page.

/** Return a storage that raises no error; `name`: "localStorage" or "sessionStorage". */
function storage(name) {
  const kept = new Map(); // values that the browser has not stored
  const use = (action, otherwise) => { try { return action(window[name]); } catch { return otherwise(); } };
  return {
    get: (key) => kept.get(key) ?? use((browser) => browser.getItem(key), () => null),
    set: (key, text) => { kept.delete(key); use((browser) => browser.setItem(key, text), () => kept.set(key, String(text))); },
    remove: (key) => { kept.delete(key); use((browser) => browser.removeItem(key), () => {}); },
  };
}

/** Storage of this browser for this station, which lasts. */
export const local = storage("localStorage");
/** Storage of this tab of the browser, which survives a reload. */
export const session = storage("sessionStorage");
