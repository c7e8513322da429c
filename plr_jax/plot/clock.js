// A play button. While it plays, the page's advance(seconds since the last call) is called for every frame.
const byId = id => document.getElementById(id);
const isStill = matchMedia("(prefers-reduced-motion: reduce)").matches;
let [playing, before] = [false, 0];

function tick(now) {
  if (!playing) return;
  const since = (now - before) / 1000;
  before = now;
  advance(since);
  requestAnimationFrame(tick);
}

function play(on) {
  const starts = on && !playing;
  playing = on;
  byId("icon").setAttribute("d", on ? "M2 1h4v12h-4zM8 1h4v12h-4z" : "M2 1L13 7L2 13z");
  if (starts) requestAnimationFrame(now => { before = now; tick(now); });
}

byId("play").addEventListener("click", () => play(!playing));
