"""Which motion a window is of: a random forest over its features, a vote, and hysteresis.

The forest (Breiman 2001) is a list of words in the tables, from FOREST on:

    number of trees, place of each tree's first node, nodes

Places count from the list's beginning. A tree's nodes are in preorder: where a split says left the
next node follows, where it says right the node so many words on. One word a node, so that a
forest of some hundred nodes is a few kilobytes (emlearn, Nordby 2019, keeps trees much like this):

    split   feature | (threshold + 4096) << 6 | right << 19
    leaf    (w1 | w2 << 6 | w3 << 12 | w4 << 18 | w5 << 24) - 2**30

Left where feature <= threshold. A split's numbers: feature 0 to 55, in the order of features.py
(28 * group + 5 * signal + kind; from 25 on the correlations), threshold -4096 to 4095, right 2 to
2047. A leaf's: a weight of 0 to 63 for each motion of `MOTIONS` but unknown; the trees' weights are
added. Each step leads on, and `objection` refuses a list whose steps lead out of it, so that a walk
always ends, in a leaf.
"""

from solenav_core.compat import const, micropython, ptr32

MOTIONS = ("unknown", "still", "walk", "run", "upstairs", "downstairs")
TREES_MAX = 64
WORDS_MAX = 4096

_TREES = const(8)  # asked in one tick
_CLASSES = const(5)
_FEATURES = const(56)
_WEIGHT = const(63)
_PAIR = const(0x3F03F)  # two weights, six bits between them
_IDLE = const(255)

_S_BLOCK_SLOT = const(210)
_S_STAGE = const(212)
_S_SUMS = const(213)
_S_SCORE = const(381)
_S_VOTE = const(386)
_S_RIVAL = const(391)
_S_RIVAL_WINDOWS = const(392)
_S_MOTION = const(393)
_P_MOTION_SHARE = const(65)
_P_MOTION_HOLD = const(66)
_T_FOREST = const(573)


def objection(words):
    """What makes `words` no forest, as a text; None for a forest."""
    size = len(words)
    if not 1 <= size <= WORDS_MAX:
        return "%d words are not 1 to %d" % (size, WORDS_MAX)
    trees = words[0]
    if not 0 <= trees <= TREES_MAX:
        return "%d trees are not 0 to %d" % (trees, TREES_MAX)
    first = 1 + trees
    if size < first:
        return "it ends within the list of its trees"
    starts = [words[1 + i] for i in range(trees)] + [size]
    if starts[0] != first:
        return "its first tree doesn't follow the list of the trees"
    for i in range(trees):
        wrong = _tree(words, starts[i], starts[i + 1])
        if wrong:
            return "tree %d: %s" % (i + 1, wrong)
    return None


def _tree(words, at, end):
    """What makes words[at:end] no tree; None for a tree."""
    if not 0 < at < end <= len(words):
        return "it has no node, or begins outside the forest"
    # The places at which the right sides still to come begin.
    waiting = []
    while at < end:
        node = words[at]
        if node >= 0:
            if node & 63 >= _FEATURES:
                return "node %d asks for feature %d" % (at, node & 63)
            waiting.append(at + (node >> 19))
            at += 1
            continue
        if node < -(1 << 30):
            return "node %d is no leaf" % at
        at += 1
        if not waiting:
            return None if at == end else "node %d belongs to nothing" % at
        if waiting.pop() != at:
            return "node %d isn't where its split says" % at
    return "a side of a split is missing"


@micropython.viper
def elect(s: ptr32, p: ptr32) -> int:
    """The windows' vote, and whether it has been the same for long enough to be the MOTION."""
    best = 0
    most = 0
    total = 0
    i = 0
    while i < _CLASSES:
        vote = (s[_S_VOTE + i] >> 1) + s[_S_SCORE + i]
        s[_S_VOTE + i] = vote
        total = total + vote
        if vote > most:
            most = vote
            best = i + 1
        i = i + 1
    if most << 8 < p[_P_MOTION_SHARE] * total:
        best = 0
    if best == s[_S_RIVAL]:
        if s[_S_RIVAL_WINDOWS] < p[_P_MOTION_HOLD]:
            s[_S_RIVAL_WINDOWS] = s[_S_RIVAL_WINDOWS] + 1
    else:
        s[_S_RIVAL] = best
        s[_S_RIVAL_WINDOWS] = 1
    if s[_S_RIVAL_WINDOWS] >= p[_P_MOTION_HOLD]:
        s[_S_MOTION] = best
    return best


@micropython.viper
def classify(at: int, node: int, s: ptr32, t: ptr32, p: ptr32, tree: int) -> int:
    """Ask eight trees, from `tree` on, about the last window; after the last of all count the vote.

    1 once the window is dealt with. `at` and `node` are 0: locals that come first are the fastest.
    """
    base = s[_S_BLOCK_SLOT] + 1
    if base > 2:
        base = 0
    base = _S_SUMS + _FEATURES * base
    if tree == 0:
        s[_S_SCORE] = 0
        s[_S_SCORE + 1] = 0
        s[_S_SCORE + 2] = 0
        s[_S_SCORE + 3] = 0
        s[_S_SCORE + 4] = 0
    stop = tree + _TREES
    if stop > t[_T_FOREST]:
        stop = t[_T_FOREST]
    # The weights in pairs, 12 bits for each sum.
    one_three = 0
    two_four = 0
    five = 0
    while tree < stop:
        at = _T_FOREST + t[_T_FOREST + 1 + tree]
        node = t[at]
        while node >= 0:
            if s[base + (node & 63)] > ((node >> 6) & 8191) - 4096:
                at = at + (node >> 19)
            else:
                at = at + 1
            node = t[at]
        one_three = one_three + (node & _PAIR)
        two_four = two_four + ((node >> 6) & _PAIR)
        five = five + ((node >> 24) & _WEIGHT)
        tree = tree + 1
    s[_S_SCORE] = s[_S_SCORE] + (one_three & 4095)
    s[_S_SCORE + 1] = s[_S_SCORE + 1] + (two_four & 4095)
    s[_S_SCORE + 2] = s[_S_SCORE + 2] + (one_three >> 12)
    s[_S_SCORE + 3] = s[_S_SCORE + 3] + (two_four >> 12)
    s[_S_SCORE + 4] = s[_S_SCORE + 4] + five
    if tree < t[_T_FOREST]:
        return 0
    int(elect(s, p))
    s[_S_STAGE] = _IDLE
    return 1
