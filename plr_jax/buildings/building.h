$PLANE
#ifndef ${NAME}_BUILDING_H
#define ${NAME}_BUILDING_H
static const float ${NAME}_lo[$COUNT][2] = {
$LO
};
static const float ${NAME}_hi[$COUNT][2] = {
$HI
};
static const double ${NAME}_shift[$COUNT][2] = {
$SHIFT
};
/* Distance to the goal from a point of floor 0 to $LAST: INFINITY outside the floor. */
static inline float ${NAME}_distance(int floor, const $TYPE x[2])
{
    if (floor < 0 || floor >= $COUNT || x[0] != x[0] || x[1] != x[1]) {
        return NAN;
    }
    float p[2];
    for (int axis = 0; axis < 2; axis++) {
        const float along = (float)x[axis];
        if (!(along >= ${NAME}_lo[floor][axis] && along <= ${NAME}_hi[floor][axis])) {
            return INFINITY;
        }
        p[axis] = (float)((double)x[axis] + ${NAME}_shift[floor][axis]);
    }
    return ${NAME}_plane_distance(p);
}
#endif
