// The distance between any two points of $DOMAIN, by plr_jax.
//
// distance([x, y], [x, y]): Infinity outside this closed domain and where no path leads, NaN where a coordinate is.
// waypoint(from, to): where to go straight to from a point towards another one; NaN where no way leads.
// bounds([x, y], [x, y]): proven bounds of the distance between points of free space, [lower, upper].
// Answers are those of pairs.numpy(), bit for bit.

$READERS
const file = Uint8Array.from(atob("$FILE"), letter => letter.charCodeAt(0));
export const { distance, waypoint, bounds } = pairsReader(readPairs(readContainer(file), file.length));
