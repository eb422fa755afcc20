"""Kinds of objects: what an object looks like, by its name, as a few parts.

The last word of a name tells what the object is; one that is not in the table is a plain box.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Literal, NamedTuple

Form = Literal[
    "block",
    "board",
    "bag",
    "basket",
    "bathtub",
    "bed",
    "books",
    "bottle",
    "bowl",
    "cabinet",
    "chair",
    "chandelier",
    "clock",
    "clothes",
    "couch",
    "counter",
    "curtain",
    "cushion",
    "door",
    "drawers",
    "fan",
    "faucet",
    "figure",
    "hearth",
    "lamp",
    "ledge",
    "light",
    "machine",
    "mirror",
    "oven",
    "pendant",
    "picture",
    "pillar",
    "plant",
    "radiator",
    "rail",
    "roll",
    "rug",
    "screen",
    "shelves",
    "sink",
    "stairs",
    "stool",
    "table",
    "tall machine",
    "toilet",
    "towel",
    "vase",
    "vent",
    "washer",
    "window",
]
Material = Literal[
    "wood",
    "cloth",
    "white",
    "glass",
    "metal",
    "dark",
    "leaf",
    "light",
    "plain",
    "clay",
    "silver",
]
Support = Literal["anywhere", "floor", "wall", "ceiling"]
Shape = Literal["box", "round", "disc", "ball", "cushion"]
"""A box; a round body that stands upright; a disc on a front; and what looks the same from all
sides, a ball or a cushion."""

Corner = tuple[float, float, float]
"""To the right, to the back and up, -1 to 1 in a solid."""


class Kind(NamedTuple):
    """What an object is built like."""

    form: Form
    material: Material
    support: Support = "anywhere"
    """Where it stands or hangs."""
    depth: float = 1.0
    """Fraction of the width."""
    tallest: float = 4.0
    """Metres: it is not higher, however high its box is."""
    widest: float = 4.0
    """Metres: it is not wider, if nothing but how wide it seems to be from elsewhere is known."""
    deepest: float = 4.0
    """Metres from its front to its back, at most."""


class Part(NamedTuple):
    """A part of a form."""

    material: Material
    low: Corner
    """The low corner; what begins or ends beyond 1 lies on the parts before it."""
    high: Corner
    shape: Shape = "box"
    profile: Sequence[tuple[float, float]] = ((-1, 1), (1, 1))
    """Heights and radii of a round part from its lower to its upper end, -1 to 1 in the part."""


_KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        word: kind
        for words, kind in {
            "picture, painting, painter, photo, poster, art, frame, photograph": Kind(
                "picture", "wood", "wall", widest=2.5
            ),
            "window, windowframe, window frame, skylight": Kind("window", "glass", "wall"),
            "mirror, glass": Kind("mirror", "silver", "wall"),
            "clock": Kind("clock", "wood", "wall", widest=0.6),
            "door, doorway, archway, arch, panel": Kind("door", "wood", "wall"),
            "tv, monitor, television, screen, laptop": Kind("screen", "dark", "wall"),
            "curtain, blinds, tapestry, shade, valence": Kind("curtain", "cloth", "wall"),
            "towel": Kind("towel", "cloth", "wall", widest=0.8),
            "clothes, robe, hanger, hat, coat": Kind("clothes", "cloth", "wall"),
            "vent": Kind("vent", "white", "wall"),
            "heater, radiator": Kind("radiator", "white", "wall"),
            "switch, thermostat, board, whiteboard, wainscotting, wall, windowsill, alarm, outlet, "
            "control, splash, sign, telephone, phone, dispenser": Kind("board", "white", "wall"),
            "table, desk, stand, workbench, sidetable": Kind("table", "wood", "floor", 0.9, 1.4),
            "bench, pew": Kind("table", "wood", "floor", 0.5, 1.1, deepest=0.8),
            "stool": Kind("stool", "wood", "floor", 1.0, 1.1, 0.6),
            "chair, seat": Kind("chair", "wood", "floor", 1.0, 1.6, 0.8),
            "armchair, sofa chair, recliner": Kind("couch", "cloth", "floor", 1.0, 1.4, 1.2),
            "couch, sofa, loveseat": Kind("couch", "cloth", "floor", 0.5, 1.4, deepest=0.8),
            "toilet, bidet": Kind("toilet", "white", "floor", 1.0, 1.2, 0.7),
            "bed": Kind("bed", "cloth", "floor", 1.0, 1.8),
            "sink, washbasin, basin": Kind("sink", "white", widest=1.2),
            "bathtub, tub": Kind("bathtub", "white", "floor", 0.5, 1.0, deepest=0.8),
            "plant, tree, flower, bush, fern, bouquet, shrubbery": Kind(
                "plant", "leaf", widest=1.5
            ),
            "lamp": Kind("lamp", "light", widest=0.7),
            "chandelier": Kind("chandelier", "light", "ceiling", tallest=1.2, widest=1.2),
            "wall lamp": Kind("light", "light"),
            "light, ceiling lamp": Kind("light", "light", "ceiling", tallest=0.5, widest=0.6),
            "fan": Kind("fan", "wood", "ceiling", tallest=0.8, widest=1.6),
            "duct, beam, rafter": Kind("block", "wood", "ceiling"),
            "sprinkler, detector, firealarm": Kind("vase", "white", "ceiling"),
            "sconce, candle, candlestick, fixture": Kind("lamp", "light"),
            "pillar, column, post": Kind("pillar", "white", "floor"),
            "cabinet, cupboard, wardrobe, counter, kitchen counter, closet, vanity, island": Kind(
                "cabinet", "wood", depth=0.7, deepest=1.0
            ),
            "dresser, drawer, nightstand, chest": Kind("drawers", "wood", "floor", 0.8, 1.7, 1.8),
            "shelf, shelves, rack, bookshelf, bookcase": Kind(
                "shelves", "wood", depth=0.6, deepest=0.6
            ),
            "fireplace": Kind("hearth", "white", "floor", 0.4, deepest=0.8),
            "countertop": Kind("counter", "white", depth=0.9),
            "refrigerator, fridge": Kind("tall machine", "white", "floor"),
            "oven, stove, dishwasher": Kind("oven", "white", "floor", 1.0, 1.4),
            "dryer, machine": Kind("washer", "white", "floor", 1.0, 1.3),
            "microwave, conditioner, hood, printer": Kind("machine", "white"),
            "piano, treadmill": Kind("block", "dark", "floor", 0.5, 1.6, deepest=0.8),
            "pillow, cushion": Kind("cushion", "cloth", tallest=0.8, widest=0.9),
            "blanket, sheet, comforter": Kind("cushion", "cloth"),
            "cloth": Kind("towel", "cloth", depth=0.2, deepest=0.8),
            "purse, bag, backpack, handbag, suitcase, luggage": Kind("bag", "cloth", depth=0.8),
            "shoe": Kind("block", "dark", depth=0.6),
            "book": Kind("books", "cloth"),
            "ottoman, footstool, footrest": Kind("stool", "cloth", "floor", 1.0, 0.8),
            "rug, carpet, mat": Kind("rug", "cloth", "floor", tallest=0.05),
            "can, trashcan, bin, bucket": Kind("basket", "metal", "floor", 1.0, 1.2, 0.6),
            "basket, hamper": Kind("basket", "clay", "floor", 1.0, 1.2),
            "extinguisher": Kind("bottle", "clay", "floor"),
            "faucet, handle, doorhandle, knob, head": Kind("faucet", "metal"),
            "pipe": Kind("block", "metal"),
            "railing, handrail, fence, fencing, baracade, rope": Kind(
                "rail", "wood", "floor", 0.1, deepest=0.8
            ),
            "rod, bar": Kind("block", "metal", "wall"),
            "bottle, toiletry, soap, canister, bottle of soap": Kind("bottle", "glass"),
            "vase, pot, flowerpot, urn, jar, pitcher, kettle, teapot, decoration, decor, ornament, "
            "trinket, knickknack, showpiece": Kind("vase", "clay", widest=0.8),
            "wall decoration, wall decor, mask": Kind("board", "plain", deepest=0.1),
            "cup, bowl, tray, fruit, food, pan": Kind("bowl", "white"),
            "plate": Kind("clock", "white", depth=0.2, deepest=0.8),
            "paper, roll": Kind("roll", "white"),
            "box, speaker": Kind("machine", "wood"),
            "pedestal": Kind("pillar", "wood", "floor"),
            "headboard": Kind("door", "wood", "floor", 0.1),
            "statue, sculpture, bust, figure, figurine, doll, toy, animal, teddy": Kind(
                "figure", "plain"
            ),
            "stair, step, staircase, stairway, doorstep": Kind("stairs", "wood", "floor"),
        }.items()
        for word in words.split(", ")
    }
)
BLOCK = Kind("machine", "plain")
"""What a name tells nothing about."""
# A shelf is a single board, and a vase a bowl, if it is at most this part of its width high.
_FLAT = 0.6


@cache
def kind_of(name: str) -> Kind:
    """Return what an object with this name is built like.

    Examples
    --------
    >>> kind_of("coffee table").form, kind_of("kitchen cabinets").form, kind_of("trophy").form
    ('table', 'cabinet', 'machine')
    """
    word = name.rpartition(" ")[2]
    known = (_KINDS.get(each) for each in (name, word, word.removesuffix("s")))
    return next(filter(None, known), BLOCK)


def shaped(kind: Kind, wide: float, high: float) -> Kind:
    """Return a kind as it is built if it is so wide and high, in metres.

    Examples
    --------
    >>> shaped(kind_of("light"), 0.3, 0.1).form, shaped(kind_of("light"), 0.2, 0.6).form
    ('light', 'pendant')
    """
    if kind.form == "light" and high > wide:
        return kind._replace(form="pendant")
    if kind.form == "shelves" and high < _FLAT * wide:
        return kind._replace(form="ledge")
    if kind.form == "vase" and high < _FLAT * wide:
        return kind._replace(form="bowl")
    return kind


@cache
def parts_of(kind: Kind) -> Sequence[Part]:
    """Return the parts that an object of a kind consists of."""
    own = kind.material

    def part(low: Corner, high: Corner) -> Part:
        return Part(own, low, high)

    def turned(
        material: Material, wide: float, low: float, high: float, *profile: tuple[float, float]
    ) -> Part:
        ends = (-wide, -wide, low), (wide, wide, high)
        return Part(material, *ends, "round", profile or ((-1, 1), (1, 1)))

    def front(
        material: Material, left: float, low: float, right: float, high: float, *, out: float = 0.03
    ) -> Part:
        return Part(material, (left, -1 - out, low), (right, -1, high))

    def legs(top: float, wide: float, material: Material = own) -> Sequence[Part]:
        ends = ((-1.0, 2 * wide - 1), (1 - 2 * wide, 1.0))
        return [
            Part(material, (left, near, -1), (right, far, top))
            for left, right in ends
            for near, far in ends
        ]

    def disc(material: Material, reach: float, out: float, up: float = 0.0) -> Part:
        low, high = (-reach, -1 - out, up - reach), (reach, -1, up + reach)
        return Part(material, low, high, "disc")

    whole = part((-1, -1, -1), (1, 1, 1))
    knobs = [front("metal", x, 0.05, x + 0.08, 0.3, out=0.08) for x in (-0.16, 0.08)]
    basin = [
        Part("metal", (-0.9, -0.86, 1), (0.9, 0.86, 1.01), "round"),
        Part("silver", (-0.75, -0.66, 1.01), (0.75, 0.6, 1.02), "round"),
    ]
    dark_inside = turned("dark", 0.8, 1.0, 1.02)
    forms: Mapping[Form, Sequence[Part]] = {
        "board": [whole, front(own, -0.88, -0.88, 0.88, 0.88)],
        "basket": [turned(own, 1, -1, 1, (-1, 0.7), (1, 1)), dark_inside],
        "bathtub": [whole, *basin],
        "bed": [
            Part("wood", (-1, 0.94, -1), (1, 1, 1)),
            *legs(-0.7, 0.04, "wood"),
            Part("white", (-0.97, -0.98, -0.75), (0.97, 0.94, -0.08)),
            Part(own, (-1, -1, -0.7), (1, 0.3, 0)),
            *(
                Part("white", (x - 0.42, 0.4, -0.05), (x + 0.42, 0.9, 0.35), "cushion")
                for x in (-0.48, 0.48)
            ),
        ],
        "books": [
            Part(material, (x, -1, -1), (x + 0.36, 1, high))
            for x, high, material in (
                (-1.0, 0.8, own),
                (-0.62, 1.0, "wood"),
                (-0.24, 0.7, "white"),
                (0.14, 0.95, "leaf"),
                (0.52, 0.75, "dark"),
            )
        ],
        "bag": [
            Part("dark", (-0.4, -0.15, 0.9), (0.4, 0.15, 1)),
            *(Part("dark", (x, -0.15, 0.3), (x + 0.1, 0.15, 0.9)) for x in (-0.4, 0.3)),
            Part(own, (-1, -1, -1), (1, 1, 0.4), "cushion"),
        ],
        "bottle": [
            turned(own, 0.8, -1, 0.8, (-1, 1), (0.2, 1), (0.5, 0.85), (0.75, 0.4), (1, 0.35)),
            turned("white", 0.35, 0.8, 1),
        ],
        "bowl": [
            turned(own, 1, -1, 1, (-1, 0.4), (-0.85, 0.4), (-0.4, 0.75), (0.3, 0.95), (1, 1)),
            turned("silver", 0.85, 1, 1.01),
        ],
        "cabinet": [
            Part("dark", (-0.94, -0.9, -1), (0.94, 1, -0.9)),
            part((-1, -1, -0.9), (1, 1, 0.92)),
            Part("white", (-1.02, -1.06, 0.92), (1.02, 1, 1)),
            *(front(own, x, -0.8, x + 0.9, 0.84) for x in (-0.95, 0.05)),
            *knobs,
        ],
        "chair": [
            *legs(-0.12, 0.07),
            Part("cloth", (-1, -1, -0.12), (1, 1, 0.02)),
            *(part((x, 0.84, 0.02), (x + 0.14, 1, 1)) for x in (-1, 0.86)),
            *(part((-0.86, 0.88, low), (0.86, 0.98, low + 0.2)) for low in (0.24, 0.52, 0.8)),
        ],
        "chandelier": [
            turned("metal", 0.05, -0.3, 1),
            turned("metal", 0.85, -0.55, -0.45),
            *(
                Part(own, (x - 0.16, y - 0.16, -0.45), (x + 0.16, y + 0.16, 0.1), "ball")
                for x, y in ((-0.8, 0.0), (-0.3, -0.7), (0.3, 0.7), (0.3, -0.7), (0.8, 0.0))
            ),
            Part(own, (-0.25, -0.25, -1), (0.25, 0.25, -0.55), "ball"),
        ],
        "clock": [
            disc(own, 1, 0.1),
            disc("white", 0.84, 0.2),
            *([] if own == "white" else [front("dark", -0.05, 0, 0.05, 0.6, out=0.3)]),
            *([] if own == "white" else [front("dark", 0, -0.04, 0.45, 0.06, out=0.3)]),
        ],
        "clothes": [
            Part("metal", (-1, -0.2, 0.94), (1, 0.2, 1)),
            *(part((x, -1, low), (x + 0.34, 1, 0.94)) for x, low in ((-0.95, -1), (0.25, -0.9))),
            Part("white", (-0.55, -1, -0.75), (-0.2, 1, 0.94)),
            Part("dark", (-0.15, -1, -0.95), (0.2, 1, 0.94)),
            Part("leaf", (0.62, -1, -0.7), (0.95, 1, 0.94)),
        ],
        "couch": [
            *legs(-0.86, 0.05, "wood"),
            part((-1, -0.95, -0.86), (1, 1, -0.4)),
            *(part((x, -1, -0.4), (x + 0.76, 0.6, -0.1)) for x in (-0.77, 0.01)),
            part((-1, 0.6, -0.4), (1, 1, 0.9)),
            *(part((x, 0.35, -0.1), (x + 0.72, 0.6, 0.75)) for x in (-0.75, 0.03)),
            *(part((x - 0.12, -1, -0.86), (x + 0.12, 1, 0.25)) for x in (-0.9, 0.9)),
        ],
        "counter": [
            Part("wood", (-0.97, -0.9, -1), (0.97, 1, 0)),
            part((-1, -1, 0), (1, 1, 1)),
        ],
        "curtain": [
            Part("metal", (-1.04, -0.4, 0.95), (1.04, 0.4, 1)),
            *(
                part((-1 + 0.2 * fold, -1 if fold % 2 else 0, -1), (-0.8 + 0.2 * fold, 1, 0.95))
                for fold in range(10)
            ),
        ],
        "cushion": [Part(own, (-1, -1, -1), (1, 1, 1), "cushion")],
        "door": [
            whole,
            *(
                front(own, x, low, x + 0.76, high, out=0.3)
                for x in (-0.84, 0.08)
                for low, high in ((-0.9, -0.1), (0.06, 0.9))
            ),
            Part("metal", (0.86, -1.5, -0.1), (0.96, -1, 0.04), "ball"),
        ],
        "drawers": [
            *legs(-0.85, 0.06),
            part((-0.96, -0.96, -0.85), (0.96, 1, 0.92)),
            part((-1, -1, 0.92), (1, 1, 1)),
            *(front(own, -0.88, z, 0.88, z + 0.5) for z in (-0.76, -0.2, 0.36)),
            *(
                Part("metal", (-0.08, -1.12, z), (0.08, -1, z + 0.12), "ball")
                for z in (-0.56, 0, 0.56)
            ),
        ],
        "fan": [
            turned("metal", 0.06, -0.2, 1),
            part((-1, -0.16, -0.3), (1, 0.16, -0.2)),
            part((-0.16, -1, -0.3), (0.16, 1, -0.2)),
            turned("metal", 0.2, -0.5, 0),
            Part("light", (-0.18, -0.18, -1), (0.18, 0.18, -0.5), "ball"),
        ],
        "faucet": [
            turned(own, 0.3, -1, 0.8),
            part((-0.25, -1, 0.5), (0.25, 0.3, 0.8)),
            part((-0.2, -1, 0.1), (0.2, -0.7, 0.5)),
            part((-0.8, -0.1, 0.8), (0.8, 0.2, 1)),
        ],
        "figure": [
            turned("dark", 0.7, -1, -0.85),
            turned(
                own,
                0.75,
                -0.85,
                0.55,
                *((-1, 0.6), (-0.3, 0.55), (0.2, 0.9), (0.6, 1), (0.85, 0.6), (1, 0.3)),
            ),
            Part(own, (-0.35, -0.35, 0.42), (0.35, 0.35, 1), "ball"),
        ],
        "hearth": [
            part((-0.92, -0.9, -1), (0.92, 1, 0.86)),
            part((-1, -1, 0.86), (1, 1, 1)),
            Part("plain", (-1, -1.3, -1), (1, -0.9, -0.93)),
            front("plain", -0.68, -0.93, 0.68, 0.5),
            front("dark", -0.55, -0.93, 0.55, 0.35, out=0.06),
            Part("wood", (-0.4, -1.09, -0.93), (0.4, -1.06, -0.78)),
        ],
        "lamp": [
            turned("metal", 0.5, -1, -0.92),
            turned("metal", 0.09, -0.92, 0.15),
            turned(own, 0.975, 0.1, 1, (-1, 1), (1, 0.67)),
        ],
        "light": [
            turned("metal", 0.5, 0.8, 1),
            turned(own, 1, -1, 0.8, (-1, 0.55), (1, 1)),
        ],
        "ledge": [
            part((-1, -1, 0.2), (1, 1, 1)),
            *(part((x, 0, -1), (x + 0.08, 1, 0.2)) for x in (-0.8, 0.72)),
        ],
        "pendant": [
            turned("metal", 0.06, -0.3, 1),
            turned(own, 1, -1, -0.3, (-1, 1), (-0.4, 0.9), (0.5, 0.5), (1, 0.2)),
        ],
        "machine": [whole, front(own, -0.85, -0.85, 0.85, 0.85)],
        "mirror": [
            Part("wood", (-1, -1, -1), (1, 1, 1)),
            front(own, -0.92, -0.93, 0.92, 0.93),
            front("glass", -0.8, -0.3, 0.3, 0.85, out=0.06),
        ],
        "oven": [
            whole,
            front("metal", -0.85, -0.85, 0.85, 0.5),
            front("dark", -0.65, -0.6, 0.65, 0.2, out=0.06),
            front("metal", -0.75, 0.36, 0.75, 0.44, out=0.15),
            *(
                Part("dark", (x - 0.09, -1.1, 0.64), (x + 0.09, -1, 0.84), "disc")
                for x in (-0.7, -0.35, 0.35, 0.7)
            ),
            *(
                Part("dark", (x - 0.3, y - 0.3, 1), (x + 0.3, y + 0.3, 1.01), "round")
                for x in (-0.45, 0.45)
                for y in (-0.45, 0.45)
            ),
        ],
        "picture": [
            whole,
            front("white", -0.86, -0.86, 0.86, 0.86),
            Part("glass", (-0.62, -1.06, -0.62), (0.62, -1.03, 0.62)),
            Part("leaf", (-0.62, -1.09, -0.62), (0.62, -1.06, -0.15)),
        ],
        "pillar": [
            part((-1, -1, -1), (1, 1, -0.92)),
            turned(own, 0.88, -0.92, 0.92, (-1, 1), (1, 0.91)),
            part((-1, -1, 0.92), (1, 1, 1)),
        ],
        "plant": [
            turned("clay", 0.5, -1, -0.45, (-1, 0.7), (1, 1)),
            *(
                Part(own, (x - size, y - size, z - size), (x + size, y + size, z + size), "ball")
                for x, y, z, size in (
                    (-0.5, 0.2, -0.05, 0.48),
                    (0.5, 0.2, 0.0, 0.48),
                    (-0.3, -0.2, 0.5, 0.45),
                    (0.32, -0.2, 0.48, 0.45),
                    (0.0, -0.4, 0.1, 0.45),
                )
            ),
        ],
        "radiator": [
            part((-1, 0, -0.9), (1, 1, 0.9)),
            *(part((-1 + 0.25 * fin, -1, -1), (-0.85 + 0.25 * fin, 1, 1)) for fin in range(8)),
        ],
        "rail": [
            part((-1, -1, 0.85), (1, 1, 1)),
            *(part((x, -0.6, -1), (x + 0.06, 0.6, 0.85)) for x in (-1, -0.52, -0.03, 0.46, 0.94)),
        ],
        "roll": [
            turned(own, 1, -1, 1),
            turned("plain", 0.35, 1, 1.02),
        ],
        "rug": [whole],
        "screen": [
            whole,
            front("metal", -0.95, -0.92, 0.95, 0.93),
            front(own, -0.93, -0.88, 0.93, 0.9, out=0.06),
        ],
        "shelves": [
            part((-1, 0.9, -1), (1, 1, 1)),
            *(part((x, -1, -1), (x + 0.08, 0.9, 1)) for x in (-1, 0.92)),
            *(part((-0.92, -1, z), (0.92, 0.9, z + 0.07)) for z in (-1, -0.36, 0.28, 0.93)),
        ],
        "sink": [
            turned(own, 0.95, -1, 0.9, (-1, 0.6), (1, 1)),
            part((-1, -1, 0.55), (1, 1, 1)),
            Part("metal", (-0.8, -0.84, 1), (0.8, 0.5, 1.01), "round"),
            Part("silver", (-0.6, -0.55, 1.01), (0.6, 0.4, 1.02), "round"),
            Part("metal", (-0.07, 0.55, 1), (0.07, 0.75, 1.4)),
            Part("metal", (-0.07, -0.1, 1.3), (0.07, 0.55, 1.4)),
        ],
        "stairs": [
            part((-1, -1 + 0.5 * step, -1), (1, -0.5 + 0.5 * step, -0.5 + 0.5 * step))
            for step in range(4)
        ],
        "stool": [
            *legs(0.8 if own == "wood" else -0.5, 0.08, "wood"),
            turned(own, 1, 0.75, 1) if own == "wood" else part((-1, -1, -0.6), (1, 1, 1)),
        ],
        "table": [
            *legs(0.86, 0.05),
            part((-0.94, -0.94, 0.66), (0.94, 0.94, 0.88)),
            part((-1, -1, 0.88), (1, 1, 1)),
        ],
        "tall machine": [
            whole,
            front(own, -0.94, -0.96, 0.94, 0.2),
            front(own, -0.94, 0.24, 0.94, 0.96),
            *(
                front("metal", -0.82, low, -0.74, high, out=0.12)
                for low, high in ((-0.4, 0.1), (0.34, 0.7))
            ),
        ],
        "toilet": [
            turned(own, 0.55, -1, -0.3, (-1, 0.8), (1, 1)),
            Part(own, (-0.85, -1, -0.35), (0.85, 0.5, -0.12), "round", ((-1, 0.75), (1, 1))),
            Part("silver", (-0.55, -0.75, -0.12), (0.55, 0.3, -0.1), "round"),
            part((-0.95, 0.5, -0.35), (0.95, 1, 0.9)),
            part((-1, 0.45, 0.9), (1, 1, 1)),
        ],
        "towel": [
            Part("metal", (-1, -0.5, 0.93), (1, 0.5, 1)),
            part((-0.88, -0.8, -1), (0.88, 0.8, 0.95)),
            front("white", -0.88, -0.72, 0.88, -0.6),
            front("white", -0.88, -0.5, 0.88, -0.44),
        ],
        "vase": [
            turned(
                own,
                1,
                -1,
                1,
                *((-1, 0.55), (-0.6, 0.8), (-0.1, 0.95), (0.3, 0.85), (0.65, 0.55), (0.85, 0.5)),
                (1, 0.65),
            ),
            turned("dark", 0.5, 1, 1.01),
        ],
        "vent": [whole, *(front("metal", -0.88, z, 0.88, z + 0.1) for z in (-0.7, -0.2, 0.3, 0.8))],
        "washer": [
            whole,
            front("metal", -0.92, 0.68, 0.92, 0.92),
            disc("metal", 0.62, 0.05, -0.1),
            disc("dark", 0.45, 0.08, -0.1),
        ],
        "window": [
            Part("white", (-1, -1, -1), (1, 1, 1)),
            *(
                front(material, x, z, x + 0.86, z + 0.86)
                for x in (-0.9, 0.04)
                for z, material in ((-0.9, own), (0.04, own))
            ),
            Part("white", (-1.06, -2.5, -1.04), (1.06, -1, -0.96)),
        ],
    }
    return forms.get(kind.form, [whole])
