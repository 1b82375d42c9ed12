"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const find = (id) => document.getElementById(id);
  const stage = find("stage"), handle = find("handle"), viewer = find("viewer");
  const sides = ["left", "right"];
  const pair = data.sources.length > 1;
  const last = data.frames.length - 1;
  const referenceIndex = data.sources.findIndex((source) => source.name === data.reference);

  const state = {
    index: 0,
    left: 0,
    right: referenceIndex >= 0 ? referenceIndex : Math.min(1, data.sources.length - 1),
    show: "pictures",
    mask: document.querySelector("input[name=mask]:checked")?.value ?? Object.keys(data.sources[0].captions)[0],
    wipe: 50,
    solo: pair ? null : "left", // "left" or "right": that picture alone
    zoom: 1, x: 0, y: 0, // the stage's top left corner in the zoomed picture, as shares of the stage
  };

  const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

  /** What a side shows: error maps exist for techniques; the reference always shows its picture. */
  function shown(side) {
    const source = data.sources[state[side]];
    const error = state.show === "errors" ? source.errors[state.index] : null;
    return { source, uri: error ?? source.pictures[state.index], isError: error !== null && error !== undefined };
  }

  function drawPictures() {
    for (const side of sides) {
      const { source, uri, isError } = shown(side);
      const image = find(`${side}-picture`);
      if (uri) { if (image.src !== uri) image.src = uri; } else image.removeAttribute("src");
      const what = isError ? `${source.name}, error` : uri ? source.name : `${source.name}: no such frame`;
      image.alt = `${what}, frame ${data.frames[state.index]}`;
      image.dataset.source = source.name;
      image.dataset.kind = isError ? "error" : "picture";
      image.dataset.frame = data.frames[state.index];
      find(`${side}-tag`).textContent = what;
      const caption = source.captions[state.mask]?.[state.index];
      find(`${side}-caption`).textContent = caption ? `${source.name}: ${caption}` : "";
      if (pair) document.querySelector(`input[name=${side}][value="${state[side]}"]`).checked = true;
    }
    if (state.left === state.right) find("right-caption").textContent = "";
    const scale = find("scale");
    if (scale) scale.hidden = state.show !== "errors";
    for (const near of [state.index + 1, state.index - 1]) preload(near);
  }

  const warm = new Map(); // decoded neighbours, so that scrubbing does not flicker
  function preload(index) {
    if (index < 0 || index > last) return;
    for (const side of sides) {
      const source = data.sources[state[side]];
      const uri = (state.show === "errors" && source.errors[index]) || source.pictures[index];
      if (!uri || warm.has(uri)) continue;
      const image = new Image();
      image.src = uri;
      warm.set(uri, image);
      if (warm.size > 12) warm.delete(warm.keys().next().value);
    }
  }

  function drawStage() {
    const wipe = state.solo === "left" ? 100 : state.solo === "right" ? 0 : state.wipe;
    find("left-layer").style.clipPath = `inset(0 ${100 - wipe}% 0 0)`;
    handle.style.left = `${wipe}%`;
    handle.setAttribute("aria-valuenow", Math.round(wipe));
    handle.setAttribute("aria-valuetext", `${Math.round(wipe)} % ${data.sources[state.left].name}`);
    if (state.solo) stage.dataset.solo = state.solo; else delete stage.dataset.solo;
    if (pair) {
      const toggle = find("toggle");
      toggle.setAttribute("aria-pressed", String(state.solo !== null));
      toggle.textContent = state.solo ? `Toggle: ${data.sources[state[state.solo]].name}` : "Toggle";
    }
    stage.classList.toggle("single", !pair);
    const transform = `translate(${-100 * state.x}%, ${-100 * state.y}%) scale(${state.zoom})`;
    for (const side of sides) find(`${side}-picture`).style.transform = transform;
    stage.classList.toggle("zoomed", state.zoom > 1);
    stage.classList.toggle("close", state.zoom >= 3);
    find("zoom-reset").textContent = `${Math.round(100 * state.zoom)} %`;
  }

  function drawFrame() {
    const frame = data.frames[state.index];
    const scrubber = find("scrubber");
    if (scrubber) {
      scrubber.value = state.index;
      scrubber.setAttribute("aria-valuetext", `Frame ${frame}`);
      find("frame-label").textContent = `Frame ${frame}`;
    }
    for (const plot of document.querySelectorAll("svg[data-first]")) {
      const { first, last: end, left, right } = plot.dataset;
      const x = +left + ((frame - first) / (end - first)) * (right - left);
      const line = plot.querySelector(".now");
      line.setAttribute("x1", x);
      line.setAttribute("x2", x);
    }
  }

  function drawMask() {
    for (const block of document.querySelectorAll(".masked")) {
      block.toggleAttribute("data-hidden", block.dataset.mask !== "" && block.dataset.mask !== state.mask);
    }
  }

  function setFrame(index) {
    state.index = clamp(index, 0, last);
    drawFrame();
    drawPictures();
  }
  function showFrame(frame) {
    const distance = (i) => Math.abs(data.frames[i] - frame);
    setFrame(data.frames.reduce((best, _, i) => (distance(i) < distance(best) ? i : best), 0));
  }
  function setWipe(percent) {
    if (!pair) return;
    state.wipe = clamp(percent, 0, 100);
    state.solo = null;
    drawStage();
  }
  function toggle() {
    if (!pair) return;
    state.solo = state.solo === "left" ? "right" : "left";
    drawStage();
  }
  function setShow(show) {
    state.show = show;
    document.querySelector(`input[name=show][value=${show}]`).checked = true;
    drawPictures();
  }
  /** Zoom by a factor about a point of the stage, given in shares of its size. */
  function zoomBy(factor, px = 0.5, py = 0.5) {
    const zoom = clamp(state.zoom * factor, 1, 16);
    state.x = clamp(((state.x + px) * zoom) / state.zoom - px, 0, zoom - 1);
    state.y = clamp(((state.y + py) * zoom) / state.zoom - py, 0, zoom - 1);
    state.zoom = zoom;
    drawStage();
  }
  function resetZoom() {
    Object.assign(state, { zoom: 1, x: 0, y: 0 });
    drawStage();
  }

  // Dragging: the divider, or the picture itself once it is zoomed.
  let drag = null;
  stage.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    const pan = state.zoom > 1 && !handle.contains(event.target);
    drag = { pan, x: event.clientX, y: event.clientY };
    stage.setPointerCapture(event.pointerId);
    if (!pan) moveWipe(event);
    handle.focus({ preventScroll: true, focusVisible: false });
    event.preventDefault();
  });
  stage.addEventListener("pointermove", (event) => {
    if (!drag) return;
    if (!drag.pan) { moveWipe(event); return; }
    const box = stage.getBoundingClientRect();
    state.x = clamp(state.x - (event.clientX - drag.x) / box.width, 0, state.zoom - 1);
    state.y = clamp(state.y - (event.clientY - drag.y) / box.height, 0, state.zoom - 1);
    Object.assign(drag, { x: event.clientX, y: event.clientY });
    drawStage();
  });
  for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, () => { drag = null; });
  function moveWipe(event) {
    const box = stage.getBoundingClientRect();
    setWipe((100 * (event.clientX - box.left)) / box.width);
  }
  stage.addEventListener("wheel", (event) => {
    if (!event.ctrlKey) return; // a plain wheel scrolls the page
    event.preventDefault();
    const box = stage.getBoundingClientRect();
    zoomBy(Math.exp(-event.deltaY / 200), (event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
  }, { passive: false });

  handle.addEventListener("keydown", (event) => {
    const step = event.shiftKey ? 10 : 2;
    const to = { ArrowLeft: state.wipe - step, ArrowDown: state.wipe - step, ArrowRight: state.wipe + step, ArrowUp: state.wipe + step, Home: 0, End: 100 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    setWipe(to);
  });
  viewer.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const action = {
      t: toggle, "+": () => zoomBy(1.5), "=": () => zoomBy(1.5), "-": () => zoomBy(1 / 1.5), 0: resetZoom,
      ",": () => setFrame(state.index - 1), ".": () => setFrame(state.index + 1),
      e: () => find("scale") && setShow(state.show === "errors" ? "pictures" : "errors"),
    }[event.key.toLowerCase()];
    if (!action) return;
    event.preventDefault();
    action();
  });

  find("toggle")?.addEventListener("click", toggle);
  find("zoom-in").addEventListener("click", () => zoomBy(1.5));
  find("zoom-out").addEventListener("click", () => zoomBy(1 / 1.5));
  find("zoom-reset").addEventListener("click", resetZoom);
  for (const side of sides) {
    find(`${side}-choice`)?.addEventListener("change", (event) => {
      state[side] = +event.target.value;
      drawPictures();
      drawStage();
    });
  }
  find("show-choice")?.addEventListener("change", (event) => setShow(event.target.value));
  find("masks")?.addEventListener("change", (event) => {
    state.mask = event.target.value;
    drawMask();
    drawPictures();
  });
  for (const button of document.querySelectorAll(".goto")) {
    button.addEventListener("click", () => {
      showFrame(+button.dataset.frame);
      stage.scrollIntoView({ block: "nearest" });
    });
  }
  for (const plot of document.querySelectorAll("svg[data-first]")) {
    plot.addEventListener("click", (event) => {
      const box = plot.getBoundingClientRect();
      const { first, last: end, left, right } = plot.dataset;
      const x = ((event.clientX - box.left) / box.width) * plot.viewBox.baseVal.width;
      showFrame(+first + ((x - left) / (right - left)) * (end - first));
    });
  }

  const play = find("play");
  if (play) {
    let timer = null;
    const stop = () => {
      clearInterval(timer);
      timer = null;
      play.textContent = "Play";
      play.setAttribute("aria-pressed", "false");
    };
    const manually = (index) => { stop(); setFrame(index); };
    find("scrubber").addEventListener("input", (event) => manually(+event.target.value));
    find("previous").addEventListener("click", () => manually(state.index - 1));
    find("next").addEventListener("click", () => manually(state.index + 1));
    play.addEventListener("click", () => {
      if (timer) { stop(); return; }
      play.textContent = "Pause";
      play.setAttribute("aria-pressed", "true");
      timer = setInterval(() => setFrame(state.index === last ? 0 : state.index + 1), 125);
    });
  }

  drawMask();
  drawStage();
  setFrame(0);
})();
