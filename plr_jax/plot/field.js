// An interactive view of a distance function. An opened file has a title, bounds and a reader { distance, bounds, route, ... }.
const { name, size, file, module, walls, box, floors, links } = {{content}};
const KINDS = ["planes", "continuous leaves", "smooth leaves", "cones"];
const COLORS = "440154 482878 3e4989 31688e 26828e 1f9e89 35b779 6ece58 b5de2b fde725".split(" ").map(hex => [0, 2, 4].map(at => parseInt(hex.slice(at, at + 2), 16)));
const MOST_BYTES = 2 ** 26, MOST_LISTED = 512, FINEST = 500, SIZE = 520, SWARM = 80, UNIT = "workspace units";
const palette = new Uint32Array(256);
for (let i = 0; i < 256; i++) {
    const at = i / 255 * (COLORS.length - 1), low = Math.min(COLORS.length - 2, Math.floor(at)), share = at - low;
    const [r, g, b] = COLORS[low].map((from, k) => Math.round(from + share * (COLORS[low + 1][k] - from)));
    palette[i] = new Uint32Array(new Uint8Array([r, g, b, 255]).buffer)[0];
}
const text = (number, digits = 4) => number === Infinity ? "infinite" : Number.isNaN(number) ? "not a number" : String(Number(number.toPrecision(digits)));
// Round a bound so that it still holds: lower bounds (side -1) down, upper bounds (side 1) up.
function boundText(number, side, digits) {
    const near = Number(number.toPrecision(digits)), step = 10 ** (Math.floor(Math.log10(Math.abs(number))) + 1 - digits);
    return text(side * near < side * number ? near + side * step : near, digits);
}
const pointText = ([x, y]) => `(${text(x - opened.shift[0])}, ${text(y - opened.shift[1])})`;
const between = (a, b, share) => a + share * (b - a);
const apart = (a, b) => Math.hypot(b[0] - a[0], b[1] - a[1]);

// State: the opened file, its mapping to pixels, both ends of the query, values of the pixels, and the swarm.
let opened = null, view = null, start = [0, 0], goal = [0, 0], values = null, largest = 0, swarm = [];
const shown = () => opened.reader;

function bytesOf(base64) { return Uint8Array.from(atob(base64), letter => letter.charCodeAt(0)); }

function openFile(bytes, title, drawn) {
    if (bytes.length > MOST_BYTES) fail(`it has more than ${MOST_BYTES} bytes`);
    const container = readContainer(bytes), { domain, layers } = container, last = layers[layers.length - 1];
    if (last.leaf === PAIRS) {
        const tables = readPairs(container, bytes.length), reader = pairsReader(tables);
        const longest = tables.lists.reduce((most, list) => Math.max(most, list.length), 0);
        if (longest > MOST_LISTED) fail(`a cell lists ${longest} corners, more than the ${MOST_LISTED} that this page supports`);
        return { ...domain, title, isOfPairs: true, walls: drawn || outlineOf(tables.outline), reader: {
            ...reader, ...tables, size: bytes.length, kind: `${tables.corners} corners, ${tables.leaves.toLocaleString("en")} cells`,
            route: (x, y) => reader.path(x, y),
        } };
    }
    if (last.leaf !== CONE) fail(`it holds ${KINDS[last.leaf] || `leaves of kind ${last.leaf}`}, which this page cannot read; use the command plr-jax view to make a page of this file`);
    const tables = readCones(container, last), { x, y, parent } = tables.sources, reader = coneReader(tables);
    const nearest = point => x.reduce((best, _, i) => apart([x[i], y[i]], point) < apart([x[best], y[best]], point) ? i : best, 0);
    const root = nearest([x, y].map(along => along[parent.findIndex((of, i) => of === i)]));
    return { ...domain, title, walls: drawn, reader: {
        ...reader, ...tables, size: bytes.length, kind: `${tables.leaves.toLocaleString("en")} cones`, goal: [x[root], y[root]],
        route(from) { // from the leaf's source along the chain of parents
            if (!Number.isFinite(reader.distance(from))) return null;
            const points = [from];
            for (let at = nearest(reader.waypoint(from)); ; at = parent[at]) {
                points.push([x[at], y[at]]);
                if (parent[at] === at) return points;
            }
        },
    } };
}

// A PLR with other leaves: the page contains its reader as code.
function openModule() {
    const { read, ...facts } = module, reader = read();
    return { ...box, title: name, walls, reader: { ...reader, ...facts, goal: null, isSourced: false, route: from => descent(reader, from) } };
}

function outlineOf({ first, x, y }) {
    const rings = [];
    for (let ring = 0; ring + 1 < first.length; ring++) {
        rings.push(Array.from({ length: first[ring + 1] - first[ring] }, (_, i) => [x[first[ring] + i], y[first[ring] + i]]));
    }
    return { isFree: true, rings };
}

// Follow the gradient: step in the best of many directions, never through a wall; look farther if no near point is lower.
function descent(reader, from) {
    let at = from, value = reader.distance(from);
    if (!Number.isFinite(value) || isWall(from)) return null;
    const step = view.width / 250, points = [from];
    const isClear = (a, b, parts) => Array.from({ length: parts }, (_, k) => [0, 1].map(axis => between(a[axis], b[axis], (k + 1) / parts))).every(x => !isWall(x));
    const lower = reach => {
        let best = value, next = null;
        for (let k = 0; k < 48; k++) {
            const ahead = [at[0] + reach * step * Math.cos(k * Math.PI / 24), at[1] + reach * step * Math.sin(k * Math.PI / 24)], there = reader.distance(ahead);
            if (there < best && isClear(at, ahead, 2 * reach)) { best = there; next = ahead; }
        }
        return next;
    };
    while (points.length < 2000) {
        const next = [1, 2, 4, 8, 16, 32].reduce((found, reach) => found || lower(reach), null);
        if (!next) break;
        at = next;
        value = reader.distance(at);
        points.push(at);
    }
    return points;
}

const shape = document.createElement("canvas").getContext("2d");
function isWall(point) {
    if (!view.path) return false;
    return shape.isPointInPath(view.path, ...toPixels(point), "evenodd") !== view.isFree;
}
function isInView(place) { return place.every((along, axis) => view.lo[axis] <= along && along <= view.hi[axis]); }
function toPixels([x, y]) { return [view.scale * (x - view.lo[0]), view.scale * (view.hi[1] - y)]; }
function ofPixels([right, down]) { return [view.lo[0] + right / view.scale, view.hi[1] - down / view.scale]; }

function look() {
    const { lo, hi, walls: drawn } = opened, width = hi[0] - lo[0], height = hi[1] - lo[1], scale = SIZE / Math.max(width, height);
    view = { lo, hi, width: Math.max(width, height), scale, across: scale * width, down: scale * height };
    const finest = opened.isOfPairs ? Math.min(FINEST, Math.sqrt(64e6 / shown().corners)) : FINEST;
    view.columns = Math.max(1, Math.round(finest * width / view.width));
    view.rows = Math.max(1, Math.round(finest * height / view.width));
    const data = !drawn ? "" : drawn.data || drawn.rings.filter(([place]) => isInView(place)).map(ring => `M${ring.map(point => toPixels(point).map(along => along.toFixed(2)).join(" ")).join("L")}Z`).join("");
    view.isFree = Boolean(drawn && drawn.isFree);
    view.path = data ? new Path2D(data) : null;
    const frame = `M0 0H${view.across}V${view.down}H0Z`;
    byId("walls").setAttribute("d", view.isFree ? frame + data : data);
    byId("stage").style.setProperty("--aspect", width / height);
    byId("marks").setAttribute("viewBox", `0 0 ${view.across} ${view.down}`);
    for (const [key, value] of [["width", view.across], ["height", view.down]]) byId("frame").setAttribute(key, value);
    for (const id of ["field", "swarm"]) {
        const pixels = id === "field" ? [view.columns, view.rows] : [2 * view.across, 2 * view.down];
        [byId(id).width, byId(id).height] = pixels.map(Math.round);
    }
    byId("walled-label").hidden = !data;
    view.sights = opened.isOfPairs ? sightsOf(shown()) : null;
}

// Return which pixels see a point, by drawing the shadow of every wall.
function seenFrom([x, y], tables, context) {
    const { columns, rows } = view, { following, x: wx, y: wy } = tables.outline;
    const at = ([px, py]) => [(px - view.lo[0]) / (view.hi[0] - view.lo[0]) * columns, (view.hi[1] - py) / (view.hi[1] - view.lo[1]) * rows];
    context.fillStyle = "#fff";
    context.fillRect(0, 0, columns, rows);
    context.fillStyle = "#000";
    context.beginPath();
    const far = 4 * Math.max(columns, rows), [cx, cy] = at([x, y]);
    for (let i = 0; i < wx.length; i++) {
        const j = following[i];
        if (Math.min(apart([wx[i], wy[i]], [x, y]), apart([wx[j], wy[j]], [x, y])) < 1e-5 * view.width) continue; // the point is a corner of this wall
        const ends = [at([wx[i], wy[i]]), at([wx[j], wy[j]])], [[ax, ay], [bx, by]] = ends;
        const [a, b] = (bx - ax) * (cy - ay) < (by - ay) * (cx - ax) ? ends : ends.reverse(); // all shadows have one orientation
        const beyond = ([px, py]) => { const length = Math.hypot(px - cx, py - cy) || 1; return [px + (px - cx) / length * far, py + (py - cy) / length * far]; };
        const corners = [a, beyond(a), beyond([(a[0] + b[0]) / 2, (a[1] + b[1]) / 2]), beyond(b), b];
        corners.forEach((corner, k) => k ? context.lineTo(...corner) : context.moveTo(...corner));
        context.closePath();
    }
    context.fill("nonzero");
    return new Uint32Array(context.getImageData(0, 0, columns, rows).data.buffer);
}
const isLit = pixel => (pixel & 255) > 127;

// For each corner, the pixels that see it and whose leaves list it, and their distances: these do not depend on the goal.
// They are computed in idle time; until then, pixels whose leaves list further corners stay blank.
function sightsOf(tables) {
    const { columns, rows } = view, canvas = document.createElement("canvas"), count = columns * rows;
    [canvas.width, canvas.height] = [columns, rows];
    const px = new Float32Array(columns), py = new Float32Array(rows), of = new Uint32Array(count);
    for (let i = 0; i < columns; i++) px[i] = between(view.lo[0], view.hi[0], (i + 0.5) / columns) - tables.middle[0];
    for (let j = 0; j < rows; j++) py[j] = between(view.hi[1], view.lo[1], (j + 0.5) / rows) - tables.middle[1];
    for (let j = 0, pixel = 0; j < rows; j++) for (let i = 0; i < columns; i++, pixel++) of[pixel] = tables.leafOf(px[i], py[j]);
    return { px, py, of, corners: [], isListed: new Uint8Array(tables.lists.length), last: tables.lists.map(list => Math.max(-1, ...list)), context: canvas.getContext("2d", { willReadFrequently: true }) };
}
function addSight(tables, { px, py, of, corners, isListed, context }) {
    const corner = corners.length, x = tables.seen.x[corner], y = tables.seen.y[corner], { columns } = view;
    const lit = seenFrom([x + tables.middle[0], y + tables.middle[1]], tables, context), pixels = [];
    tables.lists.forEach((list, leaf) => { isListed[leaf] = list.includes(corner) ? 1 : 0; });
    for (let pixel = 0; pixel < lit.length; pixel++) if (isListed[of[pixel]] && isLit(lit[pixel])) pixels.push(pixel);
    corners.push({ pixels: Uint32Array.from(pixels), cornerDistances: Float32Array.from(pixels, pixel => tables.legLength(px[pixel % columns], py[Math.floor(pixel / columns)], x, y)) });
}
function addSights(of = view) {
    if (view !== of) return; // another file was opened meanwhile
    const tables = shown(), { sights } = view, until = performance.now() + 30;
    while (sights.corners.length < tables.corners && performance.now() < until) addSight(tables, sights);
    drawField();
    if (sights.corners.length < tables.corners) setTimeout(addSights, 0, view); else drawAll();
}

function fieldOfPairs(tables) {
    const { corners, context, px, py, of, last } = view.sights, { columns, rows } = view;
    const gx = f(goal[0] - tables.middle[0]), gy = f(goal[1] - tables.middle[1]), toGoal = new Float32Array(tables.corners).fill(Infinity);
    for (const corner of tables.lists[tables.leafOf(gx, gy)]) {
        const x = tables.seen.x[corner], y = tables.seen.y[corner];
        if (tables.hides(tables.seen, gx, gy, x, y)) continue;
        const leg = tables.legLength(gx, gy, x, y), distances = tables.row(corner);
        for (let k = 0; k < toGoal.length; k++) { const way = f(leg + distances[k]); if (way < toGoal[k]) toGoal[k] = way; }
    }
    const lit = seenFrom(goal, tables, context), found = new Float32Array(columns * rows).fill(Infinity);
    corners.forEach(({ pixels, cornerDistances }, corner) => {
        const onward = toGoal[corner];
        if (onward < Infinity) for (let k = 0; k < pixels.length; k++) { const way = cornerDistances[k] + onward; if (way < found[pixels[k]]) found[pixels[k]] = way; }
    });
    for (let j = 0, pixel = 0; j < rows; j++) for (let i = 0; i < columns; i++, pixel++) {
        if (isLit(lit[pixel])) { const dx = px[i] - gx, dy = py[j] - gy; found[pixel] = Math.sqrt(dx * dx + dy * dy); }
        else if (last[of[pixel]] >= corners.length) found[pixel] = Infinity;
    }
    return found;
}

function fieldOfPLR({ distance }) {
    const { columns, rows, lo, hi } = view, found = new Float32Array(columns * rows), x = [0, 0];
    for (let j = 0, pixel = 0; j < rows; j++) {
        x[1] = between(hi[1], lo[1], (j + 0.5) / rows);
        for (let i = 0; i < columns; i++, pixel++) { x[0] = between(lo[0], hi[0], (i + 0.5) / columns); found[pixel] = distance(x); }
    }
    return found;
}

function niceStep(range) {
    const power = 10 ** Math.floor(Math.log10(range)), share = range / power;
    return power * (share < 1.5 ? 1 : share < 3.5 ? 2 : share < 7.5 ? 5 : 10);
}

function drawField() {
    values = opened.isOfPairs ? fieldOfPairs(shown()) : fieldOfPLR(shown());
    const { columns, rows } = view, context = byId("field").getContext("2d"), image = context.createImageData(columns, rows);
    const colors = new Uint32Array(image.data.buffer);
    const before = largest; // the scale only grows, so that colors change little while an end is dragged
    largest = values.reduce((most, value) => value < Infinity && value > most ? value : most, largest) || 1;
    if (largest !== before) drawLegend();
    const step = niceStep(largest / 14), times = 255 / largest, isContoured = byId("contoured").checked;
    for (let j = 0, pixel = 0; j < rows; j++) for (let i = 0; i < columns; i++, pixel++) {
        const value = values[pixel];
        if (!(value < Infinity)) continue;
        let color = palette[value < 0 ? 0 : value > largest ? 255 : value * times | 0];
        if (isContoured) {
            const line = Math.floor(value / step), right = i + 1 < columns ? values[pixel + 1] : value, below = j + 1 < rows ? values[pixel + columns] : value;
            if (Math.floor(right / step) !== line || Math.floor(below / step) !== line) color = 0xff000000 | (color >> 1 & 0x7f7f7f);
        }
        colors[pixel] = color;
    }
    context.putImageData(image, 0, 0);
}

function drawLegend() {
    byId("colors").style.background = `linear-gradient(to right, ${COLORS.map(rgb => `rgb(${rgb})`).join(", ")})`;
    const step = niceStep(largest / 14);
    byId("colors").setAttribute("aria-label", `Colors from dark violet at distance 0 through green to yellow at ${boundText(largest, 1, 4)} ${UNIT}`);
    const spacing = niceStep(largest / 5), ticks = [largest]; // the end, and multiples that leave room for its label
    for (let k = 0; k * spacing < 0.9 * largest; k++) ticks.push(k * spacing);
    byId("ticks").replaceChildren(...ticks.map(at => Object.assign(document.createElement("span"), { textContent: at === largest ? boundText(at, 1, 4) : text(at), style: `left: ${100 * at / largest}%` })));
    byId("contoured").parentElement.lastChild.textContent = ` Contours, ${text(step)} apart`;
}

function drawCells() {
    const { tree, root } = shown(), data = [], { lo, hi } = opened.domain;
    const most = [view.across, view.down]; // of a plane of several floors, only one is in view
    const place = (x, y) => toPixels([between(lo[0], hi[0], x), between(lo[1], hi[1], y)]).map((along, axis) => Number(Math.min(most[axis], Math.max(0, along)).toFixed(2)));
    if (byId("celled").checked) for (const stack = [[root, 0, 0, 1, 1]]; stack.length; ) {
        const [code, x0, y0, x1, y1] = stack.pop(), axis = code & 3, at = 2 * (code >>> 2);
        if (axis === 2) { const [left, low] = place(x0, y0), [right, high] = place(x1, y1); if (left < right && high < low) data.push(`M${left} ${low}V${high}H${right}`); }
        else if (axis) stack.push([tree[at], x0, y0, x1, (y0 + y1) / 2], [tree[at + 1], x0, (y0 + y1) / 2, x1, y1]);
        else stack.push([tree[at], x0, y0, (x0 + x1) / 2, y1], [tree[at + 1], (x0 + x1) / 2, y0, x1, y1]);
    }
    byId("cells").setAttribute("d", data.join(""));
}

function ask() {
    const { distance, bounds, route } = shown(), ends = opened.isOfPairs ? [start, goal] : [start];
    const found = distance(...ends), path = Number.isFinite(found) && !isWall(start) ? route(...ends) : null;
    if (found < Infinity && found > largest && !isWall(start)) { largest = found; drawField(); } // a point beyond the centers of pixels
    let says = `From ${pointText(start)} to ${opened.isOfPairs || shown().goal && !opened.isFloor ? pointText(goal) : "the goal"}: `;
    says += found === Infinity ? "no path is known." : `${text(found)} ${UNIT}.`;
    if (bounds && found < Infinity) {
        const [lower, upper] = bounds(...ends);
        says += upper < Infinity ? ` Proven to be between ${boundText(lower, -1, 7)} and ${boundText(upper, 1, 7)}, if this point is free.` : ` Proven to be at least ${boundText(lower, -1, 7)}.`;
    }
    if (isWall(start)) says += " This point is inside a wall, where the distance is meaningless.";
    else if (path && shown().isSourced === false) {
        const long = path.reduce((sum, to, k) => k ? sum + apart(path[k - 1], to) : 0, 0), last = path[path.length - 1];
        says += apart(last, goal) < view.width / 50 ? ` A path along the gradient has length ${text(long)}.` : ` A path along the gradient ends at ${pointText(last)}.`;
    }
    else if (path) says += ` The stored path has ${path.length - 1} ${path.length === 2 ? "segment" : "segments"}.`;
    if (path && opened.isFloor && shown().isSourced !== false) { // the path ends at the goal, or at a link
        const end = path[path.length - 1], link = links.find(({ at }) => apart(at, end) < 1e-5 * view.width);
        if (link) says += ` It takes link ${link.index}, to floor ${link.to}.`;
    }
    byId("readout").textContent = says;
    const points = path ? path.map(point => toPixels(point).map(along => along.toFixed(2)).join(",")).join(" ") : "";
    for (const id of ["under", "path"]) byId(id).setAttribute("points", points);
    [["start", start], ["goal", goal]].forEach(([id, point]) => ["cx", "cy"].forEach((key, axis) => byId(id).setAttribute(key, toPixels(point)[axis])));
}

function describe() {
    const { kind, size, error } = shown(), proof = error === undefined || error === null ? "without a proven error bound" : error < Infinity ? `error at most ${boundText(error, 1, 3)}, proven` : "with proven lower bounds only";
    byId("title").textContent = opened.title;
    byId("facts").textContent = `${size.toLocaleString("en")} bytes; ${kind}; ${opened.isOfPairs ? "exact up to rounding, with proven bounds" : proof}. ${opened.isOfPairs ? "The distance between any two points" : "The distance to the goal"}, around walls, in ${UNIT}.`;
    byId("stage").classList.toggle("draggable", Boolean(opened.isOfPairs));
    byId("help").textContent = opened.isOfPairs
        ? "Drag either end; click elsewhere to start a swarm there. Keys: arrows move the start, Shift and arrows the goal; Enter starts a swarm."
        : "Move the pointer to query a point; click to start a swarm there. Keys: arrows move the point; Enter starts a swarm.";
    const { lo, hi } = opened, lattice = [0.1, 0.3, 0.5, 0.7, 0.9], rows = lattice.slice().reverse();
    byId("words").textContent = `The map reaches from ${pointText(lo)} to ${pointText(hi)}. Distances reach ${boundText(largest, 1, 4)} ${UNIT}. The goal is at ${pointText(goal)}. Rows of the table go from the top of the map to the bottom.`;
    const cell = (kind, content) => Object.assign(document.createElement(kind), { textContent: content });
    const line = cells => { const row = document.createElement("tr"); row.append(...cells); return row; };
    const at = (axis, share) => between(lo[axis], hi[axis], share);
    const head = line([cell("td", ""), ...lattice.map(share => Object.assign(cell("th", `x ${text(at(0, share) - opened.shift[0])}`), { scope: "col" }))]);
    byId("table").replaceChildren(byId("table").caption, head, ...rows.map(down => line([
        Object.assign(cell("th", `y ${text(at(1, down) - opened.shift[1])}`), { scope: "row" }),
        ...lattice.map(share => { const x = [at(0, share), at(1, down)]; return cell("td", isWall(x) ? "wall" : text(shown().distance(...(opened.isOfPairs ? [x, goal] : [x])))); }),
    ])));
}

function lowest() {
    const at = values.reduce((best, value, pixel) => value < values[best] ? pixel : best, 0);
    return [between(view.lo[0], view.hi[0], (at % view.columns + 0.5) / view.columns), between(view.hi[1], view.lo[1], (Math.floor(at / view.columns) + 0.5) / view.rows)];
}
// Return a point near a relative position in the map from which the goal, if one is given, can be reached: away from walls, or at least free.
function freeNear(shares, to) {
    const around = ([x, y], radius) => Array.from({ length: 16 }, (_, k) => [x + radius * view.width * Math.cos(k * Math.PI / 8), y + radius * view.width * Math.sin(k * Math.PI / 8)]);
    const isFree = place => isInView(place) && !isWall(place), at = shares.map((share, axis) => between(opened.lo[axis], opened.hi[axis], share));
    for (const clearance of [0.04, 0.02, 0.01, 0]) for (let radius = 0; radius < 1; radius += 0.02) for (const place of around(at, radius)) {
        if (isFree(place) && around(place, clearance).every(isFree) && !(to && shown().distance(...to(place)) === Infinity)) return place;
    }
    return at;
}

function show(content) {
    const before = [opened, view];
    try {
        opened = { domain: content, shift: [0, 0], isFloor: false, ...content };
        largest = 0;
        look();
        if (content.isOfPairs) goal = freeNear([0.08, 0.08]);
        if (content.isOfPairs) addSights(); else drawField();
        if (!content.isOfPairs) goal = !opened.isFloor && shown().goal || lowest();
        start = freeNear([0.93, 0.93], place => content.isOfPairs ? [place, goal] : [place]);
    } catch (error) {
        [opened, view] = before;
        throw error;
    }
    byId("floor-label").hidden = !opened.isFloor;
    byId("celled").checked = false;
    swarm = [];
    play(false);
    drawAll();
}
function drawAll() { drawLegend(); drawCells(); describe(); ask(); drawSwarm(); }

function refuse(title, error) {
    byId("error").hidden = false;
    byId("error").textContent = `${title} cannot be shown: ${error.message}.`;
}
// Open bytes from the user; on an error, show a message and keep the current view.
function take(bytes, title) {
    byId("error").hidden = true;
    try { show(openFile(bytes, title)); } catch (error) { refuse(title, error); }
}
async function takeFile(given) {
    if (!given) return;
    if (given.size > MOST_BYTES) refuse(given.name, new Error(`it has more than ${MOST_BYTES} bytes`));
    else take(new Uint8Array(await given.arrayBuffer()), given.name);
}

// Start a swarm of points around a position; they flow to the goal.
function startSwarm(at) {
    let seed = 1;
    const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
    swarm = [];
    for (let tries = 0; tries < 20 * SWARM && swarm.length < SWARM; tries++) {
        const radius = 0.05 * view.width * Math.sqrt(random()), turn = 2 * Math.PI * random();
        const from = [at[0] + radius * Math.cos(turn), at[1] + radius * Math.sin(turn)];
        const ends = opened.isOfPairs ? [from, goal] : [from];
        if (isWall(from) || !(shown().distance(...ends) < Infinity)) continue;
        const path = shown().route(...ends);
        if (!path) continue;
        const gone = [0];
        for (let k = 1; k < path.length; k++) gone.push(gone[k - 1] + apart(path[k - 1], path[k]));
        swarm.push({ path, gone, way: 0 });
    }
    if (isStill) swarm.forEach(one => { one.way = one.gone[one.gone.length - 1]; });
    drawSwarm();
    play(!isStill && swarm.length > 0);
}
function placeOf({ path, gone, way }) {
    let k = 1;
    while (k < gone.length - 1 && gone[k] < way) k++;
    if (gone.length < 2) return path[0];
    const share = Math.min(1, (way - gone[k - 1]) / (gone[k] - gone[k - 1] || 1));
    return [between(path[k - 1][0], path[k][0], share), between(path[k - 1][1], path[k][1], share)];
}
function advance(since) {
    let moves = false;
    for (const one of swarm) {
        const end = one.gone[one.gone.length - 1];
        one.way = Math.min(end, one.way + since * view.width / 4);
        moves = moves || one.way < end;
    }
    drawSwarm();
    if (!moves) play(false);
}
function drawSwarm() {
    const canvas = byId("swarm"), context = canvas.getContext("2d");
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.lineWidth = 2;
    context.strokeStyle = "#000";
    context.fillStyle = "#ffd9a0";
    for (const one of swarm) {
        const [x, y] = toPixels(placeOf(one));
        context.beginPath();
        context.arc(2 * x, 2 * y, 6, 0, 7);
        context.fill();
        context.stroke();
    }
}

// Pointer, keyboard and file input.
let dragged = null;
const stage = byId("stage");
function placeUnder(event) {
    const { left, top, width, height } = stage.getBoundingClientRect();
    return ofPixels([(event.clientX - left) / width * view.across, (event.clientY - top) / height * view.down])
        .map((along, axis) => Math.min(view.hi[axis], Math.max(view.lo[axis], along)));
}
let drawsSoon = false;
function move(end, place) {
    if (end === "goal") {
        goal = place;
        if (!drawsSoon) { drawsSoon = true; requestAnimationFrame(() => { drawsSoon = false; drawField(); }); }
    } else start = place;
    ask();
}
stage.addEventListener("pointerdown", event => {
    const place = placeUnder(event), reach = (event.pointerType === "touch" ? 30 : 16) / stage.clientWidth * view.across / view.scale;
    if (opened.isOfPairs) dragged = apart(place, start) < reach ? "start" : apart(place, goal) < reach ? "goal" : null;
    if (dragged) stage.setPointerCapture(event.pointerId);
    else { if (!opened.isOfPairs) move("start", place); startSwarm(place); }
});
stage.addEventListener("pointermove", event => {
    if (dragged) move(dragged, placeUnder(event));
    else if (!opened.isOfPairs) move("start", placeUnder(event));
});
for (const kind of ["pointerup", "pointercancel"]) stage.addEventListener(kind, () => { if (dragged === "goal") describe(); dragged = null; });
stage.addEventListener("keydown", event => {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (way) {
        const end = event.shiftKey && opened.isOfPairs ? "goal" : "start", from = end === "goal" ? goal : start;
        move(end, from.map((along, axis) => Math.min(view.hi[axis], Math.max(view.lo[axis], along + way[axis] * view.width / 50))));
    } else if (event.key === "Enter" || event.key === " ") startSwarm(start);
    else return;
    event.preventDefault();
});
byId("contoured").addEventListener("change", drawField);
byId("walled").addEventListener("change", event => { byId("walls").style.display = event.target.checked ? "" : "none"; });
byId("celled").addEventListener("change", drawCells);
byId("file").addEventListener("change", event => takeFile(event.target.files[0]));
addEventListener("dragover", event => event.preventDefault());
addEventListener("drop", event => { event.preventDefault(); takeFile(event.dataTransfer.files[0]); });

// A building: all floors lie side by side in one plane, of which one floor is shown.
function openFloors(whole) {
    whole.reader.size = size; // of a building's file, with its floors and links
    if (!floors) return show(whole);
    const select = byId("floor"), showFloor = () => show({ ...whole, domain: whole, isFloor: true, ...floors[select.selectedIndex] });
    select.replaceChildren(...floors.map((_, k) => Object.assign(document.createElement("option"), { textContent: String(k) })));
    select.addEventListener("change", showFloor);
    showFloor();
}
try { openFloors(file ? openFile(bytesOf(file), name, walls) : openModule()); } catch (error) { refuse(name, error); }
