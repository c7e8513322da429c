// Reads PLR files of cones in the plane, and the container of files of pairs; the format is described in FORMAT.md.
// Invalid files throw an Error with a message for users. Needs the functions f and beside of javascript.py.

const fail = what => { throw new Error(what); };
const EARLY = "the data end too early", LARGEST = 1e30, PAIRS = 7, CONE = 3;

function crc32(bytes, crc) {
    for (const byte of bytes) {
        crc ^= byte;
        for (let bit = 0; bit < 8; bit++) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb88320 : 0);
    }
    return crc;
}

class ByteReader {
    constructor(bytes) { this.bytes = bytes; this.at = 0; }
    byte() { return this.at < this.bytes.length ? this.bytes[this.at++] : fail(EARLY); }
    varint() {
        let value = 0;
        for (let place = 0; place < 10; place++) {
            const byte = this.byte();
            value += (byte & 127) * 2 ** (7 * place);
            if (byte < 128) return value;
        }
        return fail("its header holds a number that is too large");
    }
    signed() { const code = this.varint(); return code % 2 ? -(code + 1) / 2 : code / 2; }
    float64() {
        if (this.at + 8 > this.bytes.length) fail(EARLY);
        return new DataView(this.bytes.buffer, this.bytes.byteOffset + (this.at += 8) - 8, 8).getFloat64(0, true);
    }
    checkText(length) {
        if (this.at + length > this.bytes.length) fail(EARLY);
        const part = this.bytes.subarray(this.at, this.at += length);
        try { new TextDecoder("utf-8", { fatal: true }).decode(part); } catch { fail("its label is no text"); }
    }
}

function readDomain(reader, isFloats) {
    let numbers = [0, 0, 0, 0];
    if (isFloats) numbers = numbers.map(() => reader.float64());
    else {
        const decimals = reader.byte();
        if (decimals > 22) fail(`its domain has coordinates of ${decimals} decimals, more than 22`);
        numbers = numbers.map(() => reader.signed());
        if (numbers.some(number => Math.abs(number) > 2 ** 53)) fail("its domain has coordinates that are too large");
        numbers = numbers.map(number => number / Number(`1e${decimals}`));
    }
    const lo = numbers.slice(0, 2), hi = numbers.slice(2);
    if (lo.some((number, axis) => number > hi[axis])) fail("its domain is periodic, which this page does not show");
    for (const axis of [0, 1]) {
        const width = hi[axis] - lo[axis];
        if (!(width > 1 / LARGEST) || !numbers.every(number => Math.abs(number) < LARGEST)) fail("its domain is no box");
    }
    return { lo, hi };
}

// Decodes the container: the domain, and the layers. A PLR has one layer, files of pairs may have several.
function readContainer(bytes) {
    const start = [...bytes.subarray(0, 4)];
    const is = text => [...text].every((letter, i) => letter.charCodeAt(0) === start[i]);
    if (is("PGP\n")) fail("it holds pairs of cells of a grid, which this page does not show");
    if (is("PLR\n") || is("CPL\n")) fail("it has an earlier format version: build it again");
    if (start[0] !== 80 || start[1] !== 0xb5) fail("it does not start like a PLR file");
    const reader = new ByteReader(bytes);
    reader.at = 2;
    const first = reader.byte(), second = reader.byte();
    const version = first & 15, namesGoals = version === 6 || version === 8, hasCutOff = version > 6;
    if (version < 5 || version > 8) fail(`it has format version ${version}, this page reads versions 5 to 8`);
    const dim = first >> 4 || reader.varint();
    if (dim !== 2) fail(`it has ${dim} axes; this page shows the plane`);
    const domain = readDomain(reader, (second & 128) > 0);
    if (second & 32) fail("its points are folded, which this page does not show");
    let sizes = [];
    if (second & 64) {
        const length = reader.varint();
        if (length > 1000) fail(`it states a label of ${length} bytes, more than 1000`);
        reader.checkText(length);
        const count = reader.varint();
        if (count > 32) fail(`it states ${count} layers, more than 32`);
        if (count && (second & 7) !== 7) fail("it is a progressive file of PLRs, which only plr_jax 0.1 reads; build it again");
        sizes = Array.from({ length: count }, () => reader.varint());
    }
    const layers = [];
    let crc = crc32(bytes.subarray(0, reader.at), -1);
    for (let at = reader.at, k = 0; k <= sizes.length; k++) {
        const isLast = k === sizes.length, end = isLast ? bytes.length : at + sizes[k];
        if (k && at === bytes.length) break; // cut off at a mark
        if (!(at + (isLast ? 0 : 1) + 4 <= end && end <= bytes.length)) fail(EARLY);
        const codes = isLast ? [second & 7, (second >> 3) & 3] : [bytes[at] & 15, bytes[at] >> 4];
        crc = crc32(bytes.subarray(at, end - 4), crc);
        if (new DataView(bytes.buffer, bytes.byteOffset + end - 4).getUint32(0, true) !== ~crc >>> 0) {
            fail("its checksum does not match: the file is truncated or corrupt");
        }
        layers.push({ leaf: codes[0], proof: codes[1], body: bytes.subarray(at + (isLast ? 0 : 1), end - 4) });
        at = end;
    }
    return { domain, layers, namesGoals, hasCutOff };
}

class BitReader {
    constructor(bytes) { this.bytes = bytes; this.at = 0; this.size = 8 * bytes.length; }
    read(width) {
        if (this.at + width > this.size) fail(EARLY);
        let value = 0, scale = 1;
        while (width > 0) {
            const shift = this.at & 7, count = Math.min(8 - shift, width);
            value += ((this.bytes[this.at >> 3] >> shift) & ((1 << count) - 1)) * scale;
            scale *= 1 << count; width -= count; this.at += count;
        }
        return value;
    }
    readAll(count, width) {
        if (this.at + count * width > this.size) fail(EARLY);
        const values = new Float64Array(count);
        for (let i = 0; i < count; i++) values[i] = this.read(width);
        return values;
    }
    float32() { return new Float32Array(new Uint32Array([this.read(32)]).buffer)[0]; }
    float64() { return new Float64Array(new Uint32Array([this.read(32), this.read(32)]).buffer)[0]; }
    coded(count) {
        if (!count) return new Float64Array(0);
        if (this.at + 5 + count > this.size) fail(EARLY);
        const order = this.read(5), widths = new Uint8Array(count), values = new Float64Array(count);
        for (let i = 0; i < count; i++) {
            while (!this.read(1)) if (order + ++widths[i] > 62) fail("it holds a number that is too large");
        }
        for (let i = 0; i < count; i++) {
            const width = order + widths[i];
            values[i] = this.read(width) + 2 ** width - 2 ** order;
            if (values[i] >= 2 ** 40) fail("it holds a number that is too large");
        }
        return values;
    }
    signed(count) { return this.coded(count).map(code => code % 2 ? (code + 1) / 2 : -code / 2); }
    // Returns the sorted members of a subset of the integers below size.
    members(size) {
        const count = this.read(32);
        if (count > size) fail(`it names ${count} members of ${size}`);
        const gaps = this.coded(count);
        let last = -1;
        return gaps.map(gap => (last += gap + 1) < size ? last : fail(`it names a member beyond the last of ${size}`));
    }
    isAtEnd() {
        if (this.size - this.at >= 8) return false;
        return this.at === this.size || this.read(this.size - this.at) === 0;
    }
}

// Reads a tree into codes for a query: for each split node, in level order, the codes of its lower and upper child.
// The code of a leaf is 4 * leaf + 2, that of a split node is 4 * (its row in the tree) + (its axis). Leaves are
// numbered in traversal order; levels are lists of nodes.
function readTree(body) {
    const axes = [], child = [], levels = [];
    for (let count = 1, first = 0; count; ) {
        if (levels.length > 60) fail("its tree is deeper than 60");
        const inner = body.readAll(count, 1), splits = [];
        for (let i = 0; i < count; i++) { axes.push(2); child.push(-1); if (inner[i]) splits.push(first + i); }
        first += count;
        splits.forEach((node, k) => { axes[node] = body.read(1); child[node] = first + 2 * k; });
        levels.push(splits);
        count = 2 * splits.length;
    }
    const index = new Int32Array(axes.length), depths = [new Uint8Array(axes.length), new Uint8Array(axes.length)];
    let leaves = 0, splits = 0;
    for (const level of levels) for (const node of level) {
        index[node] = splits++;
        for (const half of [child[node], child[node] + 1]) {
            depths.forEach((depth, axis) => { depth[half] = depth[node] + (axes[node] === axis ? 1 : 0); });
            if (depths[axes[node]][half] > 23) fail("a cell is split more than 23 times along one axis");
        }
    }
    for (const stack = [0]; stack.length; ) {
        const node = stack.pop();
        if (child[node] < 0) index[node] = leaves++; else stack.push(child[node] + 1, child[node]);
    }
    const code = node => 4 * index[node] + axes[node], tree = new Uint32Array(Math.max(2, 2 * splits));
    for (const level of levels) for (const node of level) {
        tree[2 * index[node]] = code(child[node]);
        tree[2 * index[node] + 1] = code(child[node] + 1);
    }
    return { tree, root: code(0), leaves, levels, child, index };
}

// The frame of a domain, relative to an origin: see Frame in plr_jax/plr/frame.py.
function outward(x, isAbove) { const near = f(x); return (isAbove ? near < x : near > x) ? beside(near, isAbove) : near; }
function frameOf(lo, hi) {
    const frame = { lo: [], hi: [], scale: [], start: [], top: [] };
    for (const axis of [0, 1]) {
        const width = hi[axis] - lo[axis], corner = outward(lo[axis], false);
        frame.lo.push(corner);
        frame.hi.push(outward(hi[axis], true));
        frame.scale.push(f(1 / width));
        frame.start.push(f(1 - (lo[axis] - corner) / width));
        const top = 2 - 2 ** -23 - frame.start[axis], rounded = f(top);
        frame.top.push(rounded > top ? beside(rounded, false) : rounded);
    }
    return frame;
}

// Cones: see plr_jax/plr/leaves/cone/codec.py.
function readCodes(body, count, origin) {
    if (origin.some(steps => Math.abs(steps) > 2 ** 60)) fail("it states coordinates in steps that are too small");
    const lowest = body.signed(2), first = new Float64Array(count);
    body.coded(count - 1).forEach((gap, i) => { first[i + 1] = first[i] + gap; });
    const width = body.read(6);
    if (width > 40) fail(`it states coordinates of ${width} bits`);
    const second = body.readAll(count, width);
    return [first, second].map((column, axis) => column.map(code => code + lowest[axis] + rint(origin[axis])));
}
// Rounds to the nearest integer, ties to even.
function rint(x) { const down = Math.floor(x), rest = x - down; return rest > 0.5 || (rest === 0.5 && down % 2) ? down + 1 : down; }

function readSources(body, domain) {
    const xs = [], ys = [];
    const add = (count, step, of) => {
        const [x, y] = readCodes(body, count, domain.lo.map(step));
        x.forEach((code, i) => { xs.push(of(code)); ys.push(of(y[i])); });
    };
    const fine = body.read(20);
    if (fine) {
        const exponent = body.read(16) - 2 ** 15;
        if (Math.abs(exponent) > 200) fail(`it states coordinates in steps of 2**${exponent}`);
        add(fine, lo => lo * 2 ** -exponent, code => code * 2 ** exponent);
    }
    const others = body.read(20);
    if (others) {
        const fraction = body.read(16);
        if (!fraction) fail("it states coordinates in steps of 1 / 0");
        add(others, lo => lo * fraction, code => code / fraction);
    }
    const count = fine + others;
    if (!count) fail("it states no sources");
    const isRoot = body.readAll(count, 1), parent = Array.from({ length: count }, (_, i) => i), offset = new Float64Array(count);
    isRoot.forEach((root, i) => { if (root) offset[i] = body.float32(); });
    const width = count > 1 ? Math.floor(Math.log2(count - 1)) + 1 : 0;
    isRoot.forEach((root, i) => { if (!root) parent[i] = body.read(width); });
    if (parent.some(of => of >= count)) fail(`it names source ${Math.max(...parent)} of ${count}`);
    // Distances to the goal, summed along the parents by pointer doubling.
    let onward = parent, length = xs.map((x, i) => { const dx = x - xs[parent[i]], dy = ys[i] - ys[parent[i]]; return Math.sqrt(dx * dx + dy * dy); });
    for (let rest = count; rest; rest >>= 1) {
        length = length.map((way, i) => way + length[onward[i]]);
        onward = onward.map(of => onward[of]);
    }
    if (onward.some(of => !isRoot[of])) fail("its sources follow one another in a circle");
    const distance = length.map((way, i) => way + offset[onward[i]]);
    if (![...offset, ...xs, ...ys, ...distance].every(number => Math.abs(number) < LARGEST)) fail("it states sources whose coordinates or distances are too large");
    return { x: xs, y: ys, parent, distance };
}

// Decodes the source of each leaf: its rank in a list of sources in the order of their last use.
function readRanks(body, leaves, count) {
    const rank = new Float64Array(leaves);
    let rest = Array.from({ length: leaves }, (_, i) => i);
    for (let each = 0; each < 3; each++) {
        const is = body.readAll(rest.length, 1);
        rest = rest.filter((_, i) => !is[i]);
        rest.forEach(leaf => { rank[leaf] = each + 1; });
    }
    body.coded(rest.length).forEach((more, i) => { rank[rest[i]] += more; });
    const recent = Array.from({ length: count }, (_, i) => i);
    return Array.from(rank, place => {
        if (place >= count) fail(`it names source ${place} of ${count}`);
        if (place) recent.unshift(...recent.splice(place, 1));
        return recent[0];
    });
}

// Decodes the proof: the least and largest difference of distance and answer for each leaf; null without a proof.
function readProof(body, kind, leaves) {
    if (kind === 0) return null;
    const stated = body.float32(), scale = Math.abs(stated);
    if (!(scale > 0 && scale < LARGEST) || (stated < 0 && kind !== 1)) fail(`it states a largest error of ${stated}`);
    const of = code => beside(f(scale * 2 ** ((code - 255) / 12)), true);
    if (kind === 1 && stated > 0) return { error: scale, lower: () => -scale, upper: () => scale };
    let lower, upper;
    if (kind === 1) {
        const count = body.read(4) + 1, codes = body.readAll(2 * count, 8), place = new Uint8Array(leaves);
        let rest = Array.from({ length: leaves }, (_, i) => i);
        for (let each = 1; each < count; each++) {
            rest = Array.from(body.members(rest.length), i => rest[i]);
            rest.forEach(leaf => place[leaf]++);
        }
        lower = place.map(of_ => codes[of_]);
        upper = place.map(of_ => codes[count + of_]);
    } else {
        lower = body.readAll(leaves, 8);
        upper = body.readAll(leaves, 8);
    }
    const open = kind === 3 && [...upper].includes(255);
    return {
        error: open ? Infinity : scale,
        lower: leaf => -of(lower[leaf]),
        upper: leaf => kind === 3 && upper[leaf] === 255 ? Infinity : of(upper[leaf]),
    };
}

// Decodes a PLR of cones into the tables that coneReader takes.
function readCones({ domain, namesGoals, hasCutOff }, layer) {
    const body = new BitReader(layer.body), { tree, root, leaves } = readTree(body);
    const sources = readSources(body, domain), ranks = readRanks(body, leaves, sources.x.length);
    const proof = readProof(body, layer.proof, leaves);
    if (namesGoals) {
        const width = body.read(6), roots = sources.parent.filter((of, source) => of === source);
        if (width > 20) fail(`it states goals of ${width} bits`);
        body.readAll(roots.length, width);
    }
    const cutOff = new Set(hasCutOff ? body.members(leaves) : []);
    if (!body.isAtEnd()) fail("it holds more data than its leaves need");
    const isFar = domain.lo.some((lo, axis) => Math.max(Math.abs(lo), Math.abs(domain.hi[axis])) > 4 * (domain.hi[axis] - lo));
    const origin = isFar ? domain.lo : [0, 0];
    const frame = frameOf(...[domain.lo, domain.hi].map(corner => corner.map((along, axis) => along - origin[axis])));
    const numbers = new Float32Array(5 * leaves), corner = frame.lo.map((along, axis) => origin[axis] + along);
    ranks.forEach((source, leaf) => numbers.set([
        cutOff.has(leaf) ? Infinity : sources.distance[source], sources.x[source] - corner[0], sources.y[source] - corner[1],
        proof ? proof.lower(leaf) : NaN, proof ? proof.upper(leaf) : NaN,
    ], 5 * leaf));
    return { ...frame, origin, tree, root, numbers, leaves, sources, error: proof && proof.error };
}
