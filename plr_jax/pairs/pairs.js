// Reads files of a PairPLR and answers by its arithmetic (plr_jax/pairs/FORMAT.md).

const EPS = 2 ** -23, RECEDING = 32 * EPS, MARGIN = RECEDING / 4, MOST_CORNERS = 8192;

function readOutline(body, origin) {
    const step = body.float64();
    if (!(step > 0 && step < Infinity)) fail(`its points are ${step} apart`);
    const maySqueeze = body.read(1) === 1, rings = body.read(32), sizes = body.coded(rings), first = [0];
    sizes.forEach(size => { if (size < 3) fail("it has a ring of fewer than three points"); first.push(first[first.length - 1] + size); });
    if (!rings) fail("it has no ring of points");
    const count = first[rings], points = [0, 1].map(() => { let at = 0; return body.signed(count).map(gap => at += gap); });
    const following = Int32Array.from(points[0], (_, i) => i + 1);
    for (let ring = 0; ring < rings; ring++) following[first[ring + 1] - 1] = first[ring];
    const before = new Int32Array(count), pastContacts = following.slice(), places = new Map();
    following.forEach((next, i) => before[next] = i);
    // A contact is a place at which several walls begin, where no path may squeeze through.
    const hasLength = i => points.some(along => along[following[i]] !== along[i]), name = i => `${points[0][i]} ${points[1][i]}`;
    if (!maySqueeze) points[0].forEach((_, i) => hasLength(i) && places.set(name(i), [...places.get(name(i)) || [], i]));
    const isContact = Array.from(points[0], (_, i) => (places.get(name(i)) || []).length > 1);
    // At a contact, the next wall is the next one counterclockwise, around the same obstacle.
    const angle = i => {
        const [dx, dy] = points.map(along => along[following[i]] - along[i]), length = Math.abs(dx) + Math.abs(dy);
        const slant = length ? dx / length : 1;
        return dy >= 0 ? 1 - slant : 3 + slant;
    };
    for (const all of places.values()) if (all.length > 1) {
        const order = all.map(i => [angle(i), i]).sort(([a], [b]) => a - b);
        order.forEach(([, i], k) => pastContacts[before[i]] = order[(k + 1) % order.length][1]);
    }
    const at = points.map((along, axis) => along.map(steps => origin[axis] + step * steps));
    return { points, first, following, pastContacts, isContact, x: at[0], y: at[1] };
}

// How far the outline's points move if all walls move back by a distance (into free space if negative), as multiples
// of the distance. Points between thin walls stay, unless `surely`.
function moves({ points, following: ring, pastContacts, isThin, x, y }, distance, surely) {
    const count = x.length, following = distance > 0 ? pastContacts : ring, before = new Int32Array(count);
    const mx = new Float64Array(count), my = new Float64Array(count), turned = [];
    following.forEach((next, i) => before[next] = i);
    // Walls of length 0 are skipped.
    const normal = (i, along) => {
        for (let steps = 0; steps < count; steps++, i = along[i]) {
            const [dx, dy] = points.map(at => at[following[i]] - at[i]), length = Math.sqrt(dx * dx + dy * dy);
            if (length) return [-dy / length, dx / length];
        }
        return [0, 0];
    };
    const length = i => { const dx = x[following[i]] - x[i], dy = y[following[i]] - y[i]; return Math.sqrt(dx * dx + dy * dy); };
    for (let i = 0; i < count; i++) {
        const [nx, ny] = normal(i, following), [bx, by] = normal(before[i], before), cosine = nx * bx + ny * by;
        const along = Math.max(1 + cosine, 1e-12);
        mx[i] = (nx + bx) / along;
        my[i] = (ny + by) / along;
        // As far as the sharpest tip needs, but at most a quarter of the walls beside it.
        const most = distance > 0 ? Math.max(4, Math.min(length(i), length(before[i])) / (4 * distance)) : 4;
        const shorter = Math.min(1, most / Math.max(Math.sqrt(mx[i] * mx[i] + my[i] * my[i]), 1e-12));
        mx[i] *= shorter;
        my[i] *= shorter;
        if (!surely && distance > 0 && isThin.has(i) && isThin.has(before[i])) mx[i] = my[i] = 0;
    }
    if (surely || distance <= 0) return [mx, my];
    for (let i = 0; i < count; i++) {
        const next = following[i], dx = x[next] - x[i], dy = y[next] - y[i];
        if (dx * (dx - distance * (mx[next] - mx[i])) + dy * (dy - distance * (my[next] - my[i])) < 0) turned.push(i, next);
    }
    turned.forEach(i => mx[i] = my[i] = 0);
    return [mx, my];
}

function movedPoints(outline, distance, surely = false) {
    const at = [outline.x, outline.y];
    return moves(outline, distance, surely).map((along, axis) => along.map((move, i) => at[axis][i] - distance * move));
}

// The corners that each leaf lists.
function readLists(body, { levels, child, index, leaves }, count, most) {
    const out = new Set(body.members(count)), lists = new Array(leaves);
    let inherited = new Map([[0, Array.from({ length: count }, (_, i) => i).filter(corner => !out.has(corner))]]), entries = 0;
    for (const splits of levels) {
        for (const [node, list] of inherited) if (child[node] < 0) { lists[index[node]] = list; entries += list.length; }
        const size = splits.reduce((sum, node) => sum + 2 * inherited.get(node).length, 0), next = new Map();
        if (entries + size > most) fail("its lists have more entries than a file of its size ought to");
        const members = splits.length ? body.members(size) : [];
        let at = 0, k = 0;
        for (const node of splits) for (const half of [child[node], child[node] + 1]) {
            next.set(half, inherited.get(node).filter(() => members[k] !== at++ || (k++, false)));
        }
        inherited = next;
    }
    return lists;
}

// The pair with a given number among all pairs i < j, in order of j, then i.
function pairOf(number) {
    let j = Math.floor((1 + Math.sqrt(1 + 8 * number)) / 2);
    if (j * (j - 1) / 2 > number) j--; else if (j * (j + 1) / 2 <= number) j++;
    return [number - j * (j - 1) / 2, j];
}

// Decodes a file and builds the tables that pairsReader needs.
function readPairs({ domain, layers }, fileBytes) {
    if (layers.some(layer => layer.leaf !== PAIRS || layer.proof)) fail("its pairs have proofs, or layers of other kinds");
    const [body, ...others] = layers.map(layer => new BitReader(layer.body));
    const width = Math.max(...domain.hi.map((hi, axis) => hi - domain.lo[axis]));
    if (width > 1e18) fail(`its domain is ${width} wide, more than 1e18`);
    const error = from => { const rounding = from.float32(); return rounding >= 0 && rounding < Infinity ? rounding : fail(`its distances err by ${rounding}`); };
    let rounding = error(body);
    const outline = readOutline(body, domain.lo), corner = body.members(outline.x.length), count = corner.length;
    if (count > MOST_CORNERS) fail(`it has ${count} corners; at most ${MOST_CORNERS} are read`);
    const joined = from => Array.from(from.members(count * (count - 1) / 2), pairOf);
    let edges, thin = [];
    if (others.length === 2) { rounding = error(others[0]); edges = joined(others.shift()); }
    else if (others.length === 1 && (count < 2 || !body.isAtEnd())) {
        edges = joined(body);
        if (!body.isAtEnd()) thin = body.members(outline.x.length);
    }
    else fail("it was cut off before its lists of corners");
    const tree = readTree(others[0]);
    if (tree.leaves > Math.max(1, 2 ** 24 / Math.max(1, count))) fail(`it has ${tree.leaves} leaves, more than tables are made of`);
    const lists = readLists(others[0], tree, count, Math.max(2 ** 20, 64 * fileBytes));
    if (!others[0].isAtEnd()) fail("it holds more data than its leaves need");

    const middle = domain.lo.map((lo, axis) => (lo + domain.hi[axis]) / 2);
    const half = domain.lo.map((lo, axis) => (domain.hi[axis] - lo) / 2);
    const reach = half.map((along, axis) => along + EPS * Math.abs(middle[axis]));
    const at = [outline.x, outline.y].map(along => Float64Array.from(corner, i => along[i]));
    const isThin = outline.isThin = new Set(thin);
    const nudged = movedPoints(outline, -0.2 * MARGIN * width), proud = movedPoints(outline, -2 * RECEDING * width);
    const recede = RECEDING * width, [mx, my] = moves(outline, recede, false);
    const endsSight = Array.from(mx, (move, i) => outline.isContact[i] || move === 0 && my[i] === 0);
    const seen = [0, 1].map(axis => Float64Array.from(corner, (i, k) => endsSight[i] ? nudged[axis][i] : at[axis][k]));
    const apart = ([cx, cy]) => 2 * cx.reduce((most, x, k) => { const dx = x - at[0][k], dy = cy[k] - at[1][k]; return Math.max(most, Math.sqrt(dx * dx + dy * dy)); }, 0);
    const free = proud.map(along => Float64Array.from(corner, i => along[i])), farthest = apart(free);
    // No certainly free path turns at a corner that a wall cuts off from the place to which the corner moves.
    at[0].forEach((px, k) => {
        const { x, y, following } = outline, py = at[1][k], qx = free[0][k], qy = free[1][k], dx = qx - px, dy = qy - py;
        for (let i = 0; i < x.length; i++) {
            const ax = x[i], ay = y[i], bx = x[following[i]], by = y[following[i]], ex = bx - ax, ey = by - ay;
            if ((dx * (py - ay) <= dy * (px - ax)) === (dx * (py - by) <= dy * (px - bx))) continue;
            if ((ex * (py - ay) - ey * (px - ax)) * (ex * (qy - ay) - ey * (qx - ax)) < 0) free[0][k] = free[1][k] = Infinity;
        }
    });
    const wallsOf = (distance, surely) => {
        const moved = movedPoints(outline, distance, surely), following = distance > 0 ? outline.pastContacts : outline.following;
        const [wx, wy] = moved.map((along, axis) => Float32Array.from(along, x => x - middle[axis]));
        const walls = Array.from(wx.keys()).flatMap(i => surely && isThin.has(i) ? [] : [wx[i], wy[i], wx[following[i]], wy[following[i]]]);
        if (distance <= 0 || surely) return walls;
        // Walls in both directions, from contacts or near tips that are cut off, to where the moved walls meet.
        for (const i of wx.keys()) {
            const { x, y } = outline, away = [x[i] - moved[0][i], y[i] - moved[1][i]];
            const far = Math.sqrt(away[0] * away[0] + away[1] * away[1]), most = outline.isContact[i] ? 0 : 4 * distance;
            if (!(far > most)) continue;
            const [sx, sy] = [x, y].map((at, axis) => f((at[i] - most / far * away[axis]) - middle[axis]));
            walls.push(sx, sy, wx[i], wy[i], wx[i], wy[i], sx, sy);
        }
        return walls;
    };
    const aroundThinWalls = [0, 1, 2, 3].flatMap(k => [...thin].flatMap(i => {
        const { x, y, following } = outline, dx = x[following[i]] - x[i], dy = y[following[i]] - y[i];
        if (dx === 0 && dy === 0) return [];
        const length = Math.sqrt(dx * dx + dy * dy), side = [recede * (-dy / length), recede * (dx / length)];
        const corner = k => [0, 1].map(axis => {
            const along = axis ? -side[0] : side[1], at = [x, y][axis], j = following[i];
            const end = k === 1 || k === 2 ? at[j] + along : at[i] - along;
            return f((k < 2 ? end + side[axis] : end - side[axis]) - middle[axis]);
        });
        return [...corner(k), ...corner((k + 1) % 4)];
    }));
    const scene = ([cx, cy], walls, isCertain) => (
        { walls: Float32Array.from(walls), isCertain, x: Float32Array.from(cx, x => x - middle[0]), y: Float32Array.from(cy, y => y - middle[1]) });
    const rounds = 16 * EPS * Math.max(...reach), neighbors = Array.from(corner, () => []);
    for (const [i, j] of edges) {
        const dx = at[0][i] - at[0][j], dy = at[1][i] - at[1][j], length = Math.sqrt(dx * dx + dy * dy);
        neighbors[i].push([j, length]);
        neighbors[j].push([i, length]);
    }
    return {
        ...frameOf(...[domain.lo, domain.hi].map(end => end.map((along, axis) => along - middle[axis]))),
        ...tree, middle, lists, neighbors, corners: count,
        seen: scene(seen, wallsOf(recede, false), false),
        sure: scene(seen, wallsOf(recede, true), false),
        free: scene(free, [...wallsOf(-recede, false), ...aroundThinWalls], true), outline,
        less: f(rounding + apart(seen) + rounds), more: f(rounding + farthest + rounds),
    };
}

// Distances from a corner to all corners along the edges between them, in 64 bits, then rounded to 32.
function distancesFrom(source, neighbors) {
    const distance = new Float64Array(neighbors.length).fill(Infinity), heap = [[0, source]];
    distance[source] = 0;
    while (heap.length) {
        const [way, node] = heap[0], last = heap.pop();
        if (heap.length) {
            let at = 0;
            for (let child = 1; child < heap.length; child = 2 * at + 1) {
                if (child + 1 < heap.length && heap[child + 1][0] < heap[child][0]) child++;
                if (heap[child][0] >= last[0]) break;
                heap[at] = heap[child];
                at = child;
            }
            heap[at] = last;
        }
        if (way > distance[node]) continue;
        for (const [next, length] of neighbors[node]) {
            if (way + length >= distance[next]) continue;
            distance[next] = way + length;
            let at = heap.push([distance[next], next]) - 1;
            for (; at && heap[(at - 1) >> 1][0] > distance[next]; at = (at - 1) >> 1) heap[at] = heap[(at - 1) >> 1];
            heap[at] = [distance[next], next];
        }
    }
    return Float32Array.from(distance);
}

// Returns functions of two points, given the result of readPairs.
function pairsReader(tables) {
    const { lo, hi, scale, start, top, tree, root, lists, neighbors, middle, seen, free, sure, less, more } = tables;
    const place = new Uint32Array(2), rows = [];
    const row = corner => rows[corner] || (rows[corner] = distancesFrom(corner, neighbors));

    // Each operation rounds to 32 bits, as in NumPy.
    function placeOf(x, axis) {
        const share = f(f(x - lo[axis]) * scale[axis]), placed = f((share < top[axis] ? share : top[axis]) + start[axis]);
        return (placed < 1 ? 1 : placed) * 8388608 << 9;
    }

    function legLength(px, py, qx, qy) {
        const dx = f(px - qx), dy = f(py - qy);
        return f(Math.sqrt(f(f(dx * dx) + f(dy * dy))));
    }

    function beside(walls, w, x, y) {
        const ax = walls[w], ay = walls[w + 1];
        return f(f(f(walls[w + 2] - ax) * f(y - ay)) - f(f(walls[w + 3] - ay) * f(x - ax)));
    }

    function hides({ walls, isCertain }, px, py, qx, qy) {
        const dx = f(qx - px), dy = f(qy - py);
        let goesIn = false, goesOut = false;
        for (let w = 0; w < walls.length; w += 4) {
            const aIsLeft = f(dx * f(py - walls[w + 1])) <= f(dy * f(px - walls[w]));
            const bIsLeft = f(dx * f(py - walls[w + 3])) <= f(dy * f(px - walls[w + 2]));
            if (aIsLeft === bIsLeft || !(f(beside(walls, w, px, py) * beside(walls, w, qx, qy)) < 0)) continue;
            if (bIsLeft) goesIn = true; else goesOut = true;
        }
        return isCertain ? goesIn || goesOut : goesIn && goesOut;
    }

    function encloses({ walls }, px, py) {
        let turns = 0;
        for (let w = 0; w < walls.length; w += 4) {
            const ay = walls[w + 1], by = walls[w + 3];
            if (ay <= py && by > py && beside(walls, w, px, py) > 0) turns++;
            if (by <= py && ay > py && beside(walls, w, px, py) < 0) turns--;
        }
        return turns === 1;
    }

    function leafOf(px, py) {
        place[0] = placeOf(px, 0);
        place[1] = placeOf(py, 1);
        let code = root;
        for (let axis = code & 3; axis !== 2; axis = code & 3) {
            const upper = place[axis] >>> 31;
            place[axis] <<= 1;
            code = tree[2 * (code >>> 2) + upper];
        }
        return code >>> 2;
    }

    // The shortest path in a scene: its length, and its first and last corner, -1 if it is straight.
    function way(scene, px, py, qx, qy) {
        if (!hides(scene, px, py, qx, qy)) return [legLength(px, py, qx, qy), -1, -1];
        const of = [lists[leafOf(px, py)], lists[leafOf(qx, qy)]];
        const legs = [[px, py], [qx, qy]].map(([x, y], end) => of[end].map(corner => legLength(x, y, scene.x[corner], scene.y[corner])));
        const sight = of.map(list => new Int8Array(list.length)); // 1: is seen, -1: is not, 0: not known
        const sees = (end, k) => {
            const x = end ? qx : px, y = end ? qy : py, corner = of[end][k];
            return (sight[end][k] || (sight[end][k] = hides(scene, x, y, scene.x[corner], scene.y[corner]) ? -1 : 1)) > 0;
        };
        for (;;) { // try the shortest path first, and drop corners that a point does not see
            let best = Infinity, first = -1, last = -1;
            for (let i = 0; i < of[0].length; i++) {
                if (sight[0][i] < 0) continue;
                const distances = row(of[0][i]);
                for (let j = 0; j < of[1].length; j++) {
                    if (sight[1][j] < 0) continue;
                    const length = f(legs[0][i] + f(legs[1][j] + distances[of[1][j]]));
                    if (length < best) { best = length; first = i; last = j; }
                }
            }
            if (first < 0) return [Infinity, -1, -1];
            const isSeen = sees(0, first);
            if (sees(1, last) && isSeen) return [best, of[0][first], of[1][last]];
        }
    }

    // Points relative to the middle, the lexicographically smaller one first; or the answer outside and for NaN.
    function counted(x, y) {
        const p = [f(x[0] - middle[0]), f(x[1] - middle[1])], q = [f(y[0] - middle[0]), f(y[1] - middle[1])];
        if ([...p, ...q].some(along => along !== along)) return NaN;
        if ([p, q].some(point => Math.abs(point[0]) > hi[0] || Math.abs(point[1]) > hi[1])) return Infinity;
        return p[0] > q[0] || (p[0] === q[0] && p[1] > q[1]) ? [q, p, true] : [p, q, false];
    }

    function distance(x, y) {
        const points = counted(x, y);
        return typeof points === "number" ? points : way(seen, ...points[0], ...points[1])[0];
    }

    function bounds(x, y) {
        const points = counted(x, y);
        if (typeof points === "number") return [points, points];
        const [p, q] = points, isClear = encloses(free, ...p) && encloses(free, ...q);
        const lower = f(f(f(1 - 16 * EPS) * way(sure, ...p, ...q)[0]) - less);
        return [lower < 0 ? 0 : lower, isClear ? f(f(f(1 + 16 * EPS) * way(free, ...p, ...q)[0]) + more) : Infinity];
    }

    // The shortest path as a list of points, with both ends; null if there is none.
    function path(x, y) {
        const points = counted(x, y);
        if (typeof points === "number") return null;
        let [length, at, last] = way(seen, ...points[0], ...points[1]);
        if (length === Infinity) return null;
        const corners = [], distances = last < 0 ? [] : row(last);
        for (; at >= 0 && corners.length <= tables.corners; ) {
            corners.push([seen.x[at] + middle[0], seen.y[at] + middle[1]]);
            if (at === last) break;
            at = neighbors[at].reduce((best, [next, leg]) => leg + distances[next] < best[1] ? [next, leg + distances[next]] : best, [-1, Infinity])[0];
        }
        if (points[2]) corners.reverse();
        return [x, ...corners, y];
    }

    // The first turn of the path from a point to another (which it is if the path is straight); NaN without a path.
    function waypoint(x, y) { return (path(x, y) || [0, [NaN, NaN]])[1]; }

    return { distance, waypoint, bounds, path, hides, legLength, leafOf, row };
}
