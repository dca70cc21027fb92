// STOP. This script is part of the document: it works before any other file of the page has arrived, and without them.
// A press goes over a socket that is used for nothing else and by POST at the same time, and is repeated until the
// station acknowledges it. Until one of the two works, the button shows that it is not connected.
"use strict";
(() => {
  const RETRY_MS = 700, TIMEOUT_MS = 3000; // interval between two STOPs, and time limit for an answer [ms]
  const FIRST_CHECK_MS = 300, CHECK_MS = 400, CHECK_TIMEOUT_MS = 1200; // checks of the connection [ms]
  const FRESH_MS = 1500; // a connection whose last answered check is older counts as lost [ms]
  const DEAD_MS = 6000; // a socket that has not answered a check for this time is replaced [ms]
  const EMERGENCY = "Use the emergency stop of the rig if anything moves.";
  const find = (id) => document.getElementById(id);
  const stored = (storage, key) => { try { return window[storage].getItem(key); } catch { return null; } }; // a browser may block its storage

  const random = () => Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");

  function identity() {
    const created = random();
    try { sessionStorage.setItem("client", created); } catch { /* the identity lasts as long as the page */ }
    return created;
  }

  const STOP = window.STOP = {
    /** Secret random identity of this browser tab. */
    client: stored("sessionStorage", "client") ?? identity(),
    /** Return "moving", "rest", or "unknown" while the page has no current data. The page's modules replace this function. */
    motion: () => "unknown",
    press,
    /** Show an alarm below the header, unless a STOP is unacknowledged; an empty text removes it. */
    alarm: (text) => { if (unacknowledged === null) alarm(text); },
  };

  // ---- a press, its repeats and its acknowledgement

  let unacknowledged = null; // the newest STOP, until the station has acknowledged it

  /** Stop every axis. Every press is a new STOP, and only its own answer acknowledges it. */
  function press() {
    const before = unacknowledged;
    clearTimeout(before?.retryTimer);
    unacknowledged = { id: random(), tries: before?.tries ?? 0, startedAt: before?.startedAt ?? performance.now(), retryTimer: 0, posts: before?.posts ?? [] };
    document.dispatchEvent(new Event("stop-press"));
    sendOverSocket(unacknowledged);
    send(unacknowledged);
  }

  function send(attempt) {
    clearTimeout(attempt.retryTimer);
    attempt.retryTimer = setTimeout(() => { showUnacknowledged(attempt); send(attempt); }, RETRY_MS);
    attempt.tries += 1;
    post("/api/stop", TIMEOUT_MS, attempt).then((answer) => {
      if (typeof answer?.confirmed === "boolean") acknowledge(attempt, answer); // a proxy may answer in place of the station
    }, (error) => {
      attempt.refusal = error.refused ? error.message : "";
      showUnacknowledged(attempt);
    });
  }

  /**
   * Post to the station and return its answer. If the station refuses, the error has the property `refused`. With an
   * `attempt`, this is its STOP, and the request can be aborted by `attempt.posts`.
   */
  async function post(path, timeout, attempt = null) {
    const ends = new AbortController(), timer = setTimeout(() => ends.abort(), timeout);
    attempt?.posts.push(ends);
    try {
      const headers = { "content-type": "application/json", "x-ctr-client": STOP.client, "x-ctr-name": encodeURIComponent(stored("localStorage", "name") ?? "") };
      if (attempt !== null) headers["x-ctr-press"] = attempt.id;
      const answer = await fetch(path, { method: "POST", headers, body: "{}", cache: "no-store", signal: ends.signal }), text = await answer.text();
      if (answer.ok) return JSON.parse(text);
      let reason = `answer ${answer.status}`;
      try { reason = JSON.parse(text).error ?? reason; } catch { /* the answer of a proxy is no JSON */ }
      throw Object.assign(new Error(reason), { refused: answer.status < 500 });
    } finally {
      clearTimeout(timer);
    }
  }

  const seconds = (attempt) => ((performance.now() - attempt.startedAt) / 1000).toFixed(1);

  function acknowledge(attempt, { confirmed, note }) {
    const late = attempt.tries === 1 ? "" : `acknowledged after ${seconds(attempt)} s and ${attempt.tries} tries`;
    const text = [late, note].filter((part) => part !== "").join("; ");
    finish(attempt, confirmed ? "" : `STOP is not confirmed: ${text}. ${EMERGENCY}`, confirmed && text !== "" ? `STOP was accepted: ${text}` : "");
  }

  function showUnacknowledged(attempt) {
    if (attempt !== unacknowledged) return;
    const tries = attempt.tries === 1 ? "tried once" : `tried ${attempt.tries} times in ${seconds(attempt)} s`;
    const what = attempt.refusal ? `STOP is refused (${attempt.refusal})` : "STOP is not acknowledged by the station";
    alarm(`${what}: ${tries}, and it is repeated until the station acknowledges it. ${EMERGENCY}`, "Give up");
  }

  /** End an attempt: show `text` as an alarm, and pass the message of a success on to the page's modules. */
  function finish(attempt, text, success = "") {
    if (attempt !== unacknowledged) return; // another answer was faster, or there is a newer press
    clearTimeout(attempt.retryTimer);
    unacknowledged = null;
    for (const ends of attempt.posts) ends.abort(); // a request that waits for a free connection would stop a later motion
    const shown = !document.dispatchEvent(new CustomEvent("stop-report", { cancelable: true, detail: success }));
    alarm(shown || text !== "" ? text : "STOP was accepted, but other parts of the page are not loaded: reload the page.");
  }

  let alarmText = null, alarmButton = null;

  /** Show an alarm below the header; an empty text removes it. */
  function alarm(text, action = "Close") {
    const box = find("alarm");
    if (box === null) return; // the document has not arrived completely
    if (alarmText === null) {
      [alarmText, alarmButton] = [document.createElement("span"), Object.assign(document.createElement("button"), { type: "button" })];
      alarmButton.addEventListener("click", () => {
        if (unacknowledged === null) alarm(""); else finish(unacknowledged, `The page no longer repeats STOP; the station has never acknowledged it. ${EMERGENCY}`);
      });
      box.append(alarmText, alarmButton);
    }
    alarmText.textContent = text;
    alarmButton.textContent = action;
    box.hidden = text === "";
  }

  // ---- the socket, and whether STOP would reach the station now

  let socket = null, askedAt = null, worksSince = -Infinity; // times of the oldest unanswered check, and of the newest answered one
  let acceptedAt = -Infinity, refusal = "", checking = false; // by POST: time of the newest accepted check, reason of a refusal

  const socketWorks = () => performance.now() - worksSince < FRESH_MS;
  const isOpen = () => socket !== null && socket.readyState === 1;

  function sendOverSocket(attempt) {
    if (isOpen()) socket.send(JSON.stringify({ press: attempt.id, client: STOP.client, name: stored("localStorage", "name") ?? "" }));
  }

  function connect() {
    let opened = null;
    try { opened = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/stop/socket`); } catch { return; } // POST remains
    [socket, askedAt] = [opened, performance.now()];
    opened.addEventListener("open", () => {
      if (opened !== socket) return;
      opened.send("check");
      if (unacknowledged !== null) sendOverSocket(unacknowledged);
    });
    opened.addEventListener("message", ({ data }) => {
      if (opened !== socket) return;
      const answer = JSON.parse(data);
      if (answer.press === undefined) [worksSince, askedAt, refusal] = [askedAt ?? worksSince, null, ""]; // of a check
      else if (answer.press === unacknowledged?.id && answer.error === undefined) acknowledge(unacknowledged, answer);
      show();
    });
    opened.addEventListener("close", () => { if (opened === socket) lose(); });
  }

  function lose() {
    [socket, worksSince] = [null, -Infinity];
    setTimeout(connect, CHECK_MS);
    show();
  }

  async function check() {
    const now = performance.now();
    if (socket !== null && askedAt !== null && now - askedAt > DEAD_MS) { socket.close(); lose(); } // a dead connection reports no end
    if (isOpen() && askedAt === null) { askedAt = now; socket.send("check"); }
    show();
    if (socketWorks() || checking) return;
    checking = true;
    try {
      if ((await post("/api/stop/check", CHECK_TIMEOUT_MS)).accepted === true) [acceptedAt, refusal] = [now, ""];
    } catch (error) {
      if (error.refused) [acceptedAt, refusal] = [-Infinity, error.message];
    }
    checking = false;
    show();
  }

  /** Show on the button whether STOP would reach the station, and why the station would refuse it. */
  function show() {
    const connected = socketWorks() || performance.now() - acceptedAt < FRESH_MS;
    const state = connected ? "" : refusal === "" ? "not connected" : "refused";
    const text = state === "refused" ? `STOP does not work in this page: ${refusal}. ${EMERGENCY}` : "";
    if (find("stop-state") !== null && find("stop-state").textContent !== state) find("stop-state").textContent = state;
    if (find("stop-refused") === null || find("stop-refused").textContent === text) return;
    find("stop-refused").textContent = text;
    find("stop-refused").hidden = text === "";
  }

  // ---- the button, the keys, and files that do not arrive

  const isButton = (event) => event.target.closest?.("#stop") != null;
  // STOP is sent when the pointer goes down, not when it is lifted. A click without a pointer comes from the keyboard.
  document.addEventListener("pointerdown", (event) => { if (isButton(event)) press(); }, true);
  document.addEventListener("click", (event) => { if (event.detail === 0 && isButton(event)) press(); }, true);

  /** Stop by Shift+Space (in a text box only while something moves), or by Escape where it has no other effect. */
  function pressed(event) {
    const motion = STOP.motion(), moves = motion !== "rest";
    const typing = event.target.closest?.("textarea, input:not([type=checkbox], [type=range])") != null;
    const space = event.code === "Space" && event.shiftKey && (moves || !typing);
    const escape = event.key === "Escape" && moves && !find("question")?.open && event.target.closest?.("select") == null;
    if (!space && !escape) return;
    event.preventDefault();
    event.stopPropagation();
    if (event.repeat) return;
    press();
    if (!escape || motion !== "unknown") return;
    for (const dialog of document.querySelectorAll("dialog[open]")) dialog.close();
    document.dispatchEvent(new CustomEvent("stop-report", { detail: "Escape is STOP while the page has no current data about the robot." }));
  }
  document.addEventListener("keydown", pressed, true);
  // The page receives no key events of its frames (scene, report, replay), so each frame gets a listener. All frames are
  // pages of this station.
  document.addEventListener("load", (event) => {
    if (event.target.contentDocument) event.target.contentWindow.addEventListener("keydown", pressed, true);
  }, true);
  document.addEventListener("error", ({ target }) => {
    const file = target.src ?? target.href;
    if (target.matches?.("script, link")) STOP.alarm(`A part of the page is missing (${file}); STOP does not need it. Reload the page.`);
  }, true);

  connect();
  setTimeout(check, FIRST_CHECK_MS);
  setInterval(check, CHECK_MS);
  document.addEventListener("readystatechange", show);
  document.addEventListener("visibilitychange", check); // a hidden page checks seldom
})();
