// times[k]: share of the duration at which step k is reached; steps[k][robot] = [x, y] or [x, y, heading], in workspace units and radians,
// headings continued beyond pi. view: pixels per workspace unit, and the corner of the bounds at the upper left.
const { seconds, hold, view, duration, times, steps } = {{motion}};
const robots = steps[0].map((_, i) => ({ place: byId("place" + i), turn: byId("turn" + i), trail: byId("trail" + i) }));

// Length in pixels of each robot's path up to each step, which is the length of its trail.
const gone = steps[0].map((_, i) => {
  const sums = [0];
  for (let k = 1; k < steps.length; k++) {
    const [a, b] = [steps[k - 1][i], steps[k][i]];
    sums.push(sums[k - 1] + view.scale * Math.hypot(b[0] - a[0], b[1] - a[1]));
  }
  return sums;
});

// Return the motion at a time (a share of the duration) and the share of it that is done. Of steps at equal times, the last counts.
function motionAt(time) {
  let [low, high] = [0, times.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle; else high = middle;
  }
  const length = times[high] - times[low];
  return [low, length > 0 ? Math.min(1, (time - times[low]) / length) : 1];
}

const between = (a, b, share) => (1 - share) * a + share * b;

function poseAt(time, i) {
  const [k, share] = motionAt(time);
  return steps[k][i].map((value, axis) => between(value, steps[k + 1][i][axis], share));
}

function show(time) {
  const [k, share] = motionAt(time);
  robots.forEach((robot, i) => {
    const [x, y, heading] = poseAt(time, i);
    const [right, down] = [view.scale * (x - view.left), view.scale * (view.top - y)];
    robot.place.setAttribute("transform", `translate(${right.toFixed(2)} ${down.toFixed(2)})`);
    if (heading !== undefined) robot.turn.setAttribute("transform", `rotate(${(-heading * 180 / Math.PI).toFixed(2)})`);
    const length = between(gone[i][k], gone[i][k + 1], share);
    robot.trail.setAttribute("stroke-dasharray", `${length.toFixed(2)} ${(gone[i][times.length - 1] + 1).toFixed(2)}`);
  });
  byId("time").value = time;
  byId("clock").value = `time ${(time * duration).toPrecision(3)} of ${duration.toPrecision(3)}`;
}

let clock = 0; // seconds of playback, including the pause at the end
const timeOf = clock => Math.min(1, clock / seconds);

function advance(since) {
  clock = (clock + since) % (seconds + hold);
  show(timeOf(clock));
}

byId("time").addEventListener("input", event => { play(false); clock = event.target.value * seconds; show(timeOf(clock)); });
show(0);
play(!isStill);
