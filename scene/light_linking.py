# SPDX-License-Identifier: GPL-3.0-or-later
"""Light linking and the shadows of lamps, as Cycles reads them: which objects a lamp lights, and which ones its light passes."""
from collections.abc import Callable

LINKED = Callable[[object, object], bool]
"""Whether an object, and what makes the instance (or the object itself), belongs to a lamp."""


class Links:
    """The lamps of a scene, evaluated or not, that do not light everything, or whose light something passes, by their names."""

    def __init__(self, scene):
        lamps = [obj.original for obj in scene.objects if obj.type == 'LIGHT']
        self._lit = _known((lamp, _linked(lamp, "receiver_collection")) for lamp in lamps)
        self._stopped = _known((lamp, _linked(lamp, "blocker_collection") if throws_shadows(lamp) else _nothing) for lamp in lamps)

    def unlit_by(self, obj, maker) -> frozenset[str]:
        """The lamps that do not light an object; maker: what makes the instance, or the object itself."""
        return frozenset(name for name, lit in self._lit.items() if not lit(obj, maker))

    def clear_to(self, obj, maker) -> frozenset[str]:
        """The lamps whose light passes an object."""
        return frozenset(name for name, stopped in self._stopped.items() if not stopped(obj, maker))


def throws_shadows(lamp) -> bool:
    """Whether anything throws a shadow in a lamp's light."""
    return getattr(getattr(lamp.data, "cycles", None), "cast_shadow", lamp.data.use_shadow)


def _nothing(obj, maker) -> bool:
    return False


def _known(pairs) -> dict[str, LINKED]:
    return {lamp.name_full: linked for lamp, linked in pairs if linked is not None}


def _linked(lamp, name: str) -> LINKED | None:
    """What a collection of a lamp's light linking says; None without one.  A collection of excluded objects alone includes all others."""
    linking = getattr(lamp, "light_linking", None)
    collection = getattr(linking, name, None)
    if collection is None:
        return None
    links = [(child.all_objects, how) for child, how in zip(collection.children, collection.collection_children)]
    links += [((obj,), how) for obj, how in zip(collection.objects, collection.collection_objects)]
    states = {obj.name_full: how.light_linking.link_state == 'INCLUDE' for members, how in links for obj in members}
    others = not any(states.values())
    return lambda obj, maker: states.get(maker.name_full, states.get(obj.name_full, others))
