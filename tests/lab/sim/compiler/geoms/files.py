"""A COLLADA file as text: boxes, one after another along x, each with a colour of its own."""

from collections.abc import Sequence

_CORNERS = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
_FACES = [  # counter-clockwise from outside
    *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
    *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
]


def collada(
    *,
    asset: str = "<up_axis>Z_UP</up_axis>",
    size: Sequence[float] = (1, 1, 1),
    colors: Sequence[Sequence[float]] = ((1, 1, 1, 1),),
    transparency: str | None = None,
    texture: str | None = None,
) -> str:
    """Boxes from the origin on. Each colour paints 12 / len(colors) faces of the one box."""
    points = " ".join(f"{x * size[0]} {y * size[1]} {z * size[2]}" for x, y, z in _CORNERS)
    share = len(_FACES) // len(colors)
    triangles, uses, effects, materials = "", "", "", ""
    clear = ""
    if transparency is not None:
        clear = (
            "<transparent><color>1 1 1 1</color></transparent>"
            f"<transparency><float>{transparency}</float></transparency>"
        )
    images, params = "", ""
    if texture is not None:
        images = (
            f'<library_images><image id="img"><init_from>{texture}</init_from></image>'
            "</library_images>"
        )
        params = (
            '<newparam sid="surf"><surface type="2D"><init_from>img</init_from></surface>'
            '</newparam><newparam sid="samp"><sampler2D><source>surf</source></sampler2D>'
            "</newparam>"
        )
    for i, color in enumerate(colors):
        faces = _FACES[i * share : (i + 1) * share]
        index = " ".join(str(v) for face in faces for v in face)
        triangles += (
            f'<triangles count="{len(faces)}" material="sym{i}">'
            f'<input semantic="VERTEX" source="#v" offset="0"/><p>{index}</p></triangles>'
        )
        uses += f'<instance_material symbol="sym{i}" target="#material{i}"/>'
        look = f"<color>{' '.join(map(str, color))}</color>"
        if texture is not None:
            look = '<texture texture="samp" texcoord="UV"/>'
        effects += (
            f'<effect id="effect{i}"><profile_COMMON>{params}<technique sid="t"><phong>'
            f"<diffuse>{look}</diffuse>{clear}</phong></technique></profile_COMMON></effect>"
        )
        materials += f'<material id="material{i}"><instance_effect url="#effect{i}"/></material>'
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset>{asset}</asset>{images}
<library_effects>{effects}</library_effects>
<library_materials>{materials}</library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="24">{points}</float_array><technique_common>
<accessor source="#pa" count="8" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
{triangles}</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g">
<bind_material><technique_common>{uses}</technique_common></bind_material>
</instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""
