"""Models of NiftySim, read from and written to its XML files.

Read are the tags that this solver can run: solid meshes (H8, T4, T4ANP) of neo-Hookean (NH), visco-neo-Hookean (NHV)
and St. Venant-Kirchhoff (LE) material, with Fix, Disp, Force, Gravity and Pressure constraints. Everything else that
NiftySim knows is refused by name, and what it does not know is reported with the nearest name it does: a model never
runs with a part of it left out.

Conventions (NiftySim 2.5, user guide 2.4 and source): NH parameters are shear and bulk modulus, LE parameters Young's
modulus and Poisson's ratio; nodes and elements are numbered from 0; a list of one number, where more are announced,
is the first of consecutive numbers; a pressure pushes against the normal of its faces, and the normal follows from the
order of their nodes by the right hand rule.
"""

from __future__ import annotations

import math
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulator.atomic import whole_file
from simulator.curves import LOAD_SHAPES, LoadShape
from simulator.elements import NODES_OF, volumes
from simulator.errors import InputError
from simulator.model import (
    Displacement,
    Fixed,
    Force,
    Gravity,
    Load,
    Material,
    Model,
    NeoHookean,
    Pressure,
    StVenantKirchhoff,
    ViscoNeoHookean,
)
from simulator.wording import choices, nearest, short
from simulator.xml_tree import Element, parse

VARIABLES = ("U", "F", "S", "E", "EKin", "EStrain")

# tag -> (its attributes, the tags inside it); what is not here is either refused by name (below) or unknown
_TAGS = {
    "Model": ((), ("Nodes", "Elements", "ElementSet", "Constraint", "SystemParams", "Output")),
    "Nodes": (("DOF", "NumNodes"), ()),
    "Elements": (("NumEls", "Type"), ()),
    "ElementSet": (("Size",), ("Material",)),
    "Material": (("Type",), ("ElasticParams", "ViscoParams", "Density")),
    "ElasticParams": (("NumParams",), ()),
    "ViscoParams": (("NumIsoTerms", "NumVolTerms"), ()),
    "Constraint": (
        ("Type", "DOF", "SpecType", "NumNodes", "LoadShape", "NumFaces", "FaceType"),
        (
            "Nodes",
            "Normal",
            "RestrictTo",
            "Faces",
            "Magnitudes",
            "Magnitude",
            "AccelerationMagnitude",
            "AccelerationDirection",
        ),
    ),
    "Normal": (("ToleranceAngle",), ()),
    "RestrictTo": (("Type",), ()),
    "Faces": ((), ()),
    "Magnitudes": (("Type",), ()),
    "Magnitude": ((), ()),
    "AccelerationMagnitude": ((), ()),
    "AccelerationDirection": ((), ()),
    "SystemParams": (
        (),
        (
            "TimeStep",
            "TotalTime",
            "DampingCoeff",
            "HGKappa",
            "Density",
            "ROM",
            "DoDeformableCollision",
            "DoSelfCollision",
            "DoMultiPassContacts",
            "BVType",
            "DeformableFrictionCoefficient",
            "ContactSafetyMargin",
            "RateConstraintDistance",
        ),
    ),
    "TimeStep": ((), ()),
    "TotalTime": ((), ()),
    "DampingCoeff": ((), ()),
    "HGKappa": ((), ()),
    "Density": ((), ()),
    "ROM": ((), ()),
    "DoDeformableCollision": (("Type",), ()),
    "DoSelfCollision": (("Type",), ()),
    "DoMultiPassContacts": ((), ()),
    "BVType": ((), ()),
    "DeformableFrictionCoefficient": ((), ()),
    "ContactSafetyMargin": ((), ()),
    "RateConstraintDistance": ((), ()),
    "Output": (("Freq",), ("Variable",)),
    "Variable": ((), ()),
}
_REFUSED = {
    "MSHMesh": "meshes in files of their own",
    "VTKMesh": "meshes in files of their own",
    "ShellElements": "membranes and shells",
    "ShellElementSet": "membranes and shells",
    "ContactSurface": "contact",
    "ContactPlate": "contact",
    "ContactCylinder": "contact",
    "ContactUSProbe": "contact",
    "KinematicContact": "contact",
    "SubModel": "submodels",
    "SubModelNodeMergerDistance": "submodels",
    "ReducedBasis": "reduced-order models",
}
_MANY = {"ElementSet", "Constraint", "RestrictTo", "Variable"}
_HOLDERS = {"Model", "Material", "Constraint", "SystemParams", "Output"}  # text in these is a slip
_MATERIALS = {"NH": NeoHookean, "NHV": ViscoNeoHookean, "LE": StVenantKirchhoff}
_REFUSED_MATERIALS = ("AB", "PY", "TI", "TIV")
_CONSTRAINTS = ("Fix", "Disp", "Force", "Gravity", "Pressure")


def read_niftysim(path: str | Path) -> Model:
    """Read a NiftySim model.

    Loads follow their shape over the total time T; `output_every` and `outputs` keep what <Output> asks for. NiftySim
    does one step more than T / TimeStep and counts a state saved at step k as k TimeStep although it has reached
    (k + 1) TimeStep: see `niftysim_times`.

    Raises
    ------
    InputError : a file that is not there, is not XML, or does not describe a model that this solver can run; one
        sentence with file and line
    """
    path = Path(path)
    root = parse(path, "a NiftySim model", _check_tag)
    _check_text(root)
    nodes = _read_nodes(root.need("Nodes"))
    elements, element_type = _read_elements(root.need("Elements"), nodes)
    loose = np.setdiff1d(np.arange(len(nodes)), elements)
    if len(loose):
        raise InputError(
            f"{root.need('Nodes').line_of(3 * loose[0])}: expected every node in an element, got node {loose[0]} "
            f"in none and {len(loose)} such in all; take them out"
        )
    system = root.need("SystemParams")
    _check_switches(system)
    materials, material_of = _read_materials(root, len(elements), system.find("Density"))
    dt = _positive(system.need("TimeStep"), "a time step in s")
    duration = _positive(system.need("TotalTime"), "a total time in s")
    if dt > duration:
        raise InputError(
            f"{system.find('TimeStep').place}: expected a time step below the total time, got {dt} s of {duration} s"
        )
    mesh = _Mesh(nodes, elements, element_type, duration)
    loads = tuple(load for one in root.all("Constraint") for load in _read_constraint(one, mesh))
    damping = _not_negative(system.need("DampingCoeff"), "a damping coefficient in 1/s")
    hourglass = system.need("HGKappa") if element_type == "H8" else system.find("HGKappa")
    hourglass = 0.0 if hourglass is None else _not_negative(hourglass, "an hourglass stiffness")
    output = root.find("Output")
    output_every = None if output is None else _whole_attribute(output, "Freq", 1)
    outputs = ("U",) if output is None else tuple(_variable(one) for one in output.all("Variable"))
    with _at(str(path)):
        return Model(
            nodes=nodes,
            elements=elements,
            element_type=element_type,
            materials=materials,
            material_of=material_of,
            loads=loads,
            damping=damping,
            hourglass=hourglass,
            dt_s=dt,
            duration_s=duration,
            output_every=output_every,
            outputs=outputs,
        )


def niftysim_times(model: Model) -> np.ndarray:
    """(K,) s: the times of the states that NiftySim saves, (k + 1) dt after every k = `output_every` steps.

    The last lies one step after `duration_s`. F, S, E and EStrain of a saved state belong to one step earlier than U.

    Raises
    ------
    InputError : a model without a time step in numbers or without `output_every`
    """
    if model.dt_s == "auto" or model.output_every is None:
        raise InputError(
            f"expected a model with a time step in s and output_every, got {model.dt_s!r} and {model.output_every}"
        )
    steps = int(model.duration_s / model.dt_s + 0.5)
    return model.dt_s * (np.arange(model.output_every, steps + 1, model.output_every) + 1)


def write_niftysim(model: Model, path: str | Path) -> None:
    """Write a model for NiftySim; `read_niftysim` gives back an equal one, number for number.

    Raises
    ------
    InputError : a load shape or a time step that NiftySim cannot express, or a place that cannot be written to
    """
    if model.dt_s == "auto":
        raise InputError("expected a time step in s to write for NiftySim, which does not find one, got dt_s='auto'")
    lines = ['<?xml version="1.0" encoding="utf-8"?>', "<Model>"]
    lines += [f'  <Nodes DOF="3" NumNodes="{len(model.nodes)}">', *_rows(model.nodes), "  </Nodes>"]
    lines += [
        f'  <Elements NumEls="{len(model.elements)}" Type="{model.element_type}">',
        *_rows(model.elements),
        "  </Elements>",
    ]
    for index, material in enumerate(model.materials):
        lines += _material_lines(material, np.flatnonzero(model.material_of == index), len(model.elements))
    for load in model.loads:
        lines += _constraint_lines(load, model)
    lines += [
        "  <SystemParams>",
        f"    <TimeStep>{float(model.dt_s)!r}</TimeStep>",
        f"    <TotalTime>{float(model.duration_s)!r}</TotalTime>",
        f"    <DampingCoeff>{float(model.damping)!r}</DampingCoeff>",
        f"    <HGKappa>{float(model.hourglass)!r}</HGKappa>",
        f"    <Density>{float(model.materials[0].density)!r}</Density>",
        "  </SystemParams>",
    ]
    if model.output_every is not None:
        lines += [f'  <Output Freq="{model.output_every}">']
        lines += [f"    <Variable>{name}</Variable>" for name in model.outputs]
        lines += ["  </Output>"]
    lines += ["</Model>", ""]
    with whole_file(path) as part:
        part.write_text("\n".join(lines), encoding="utf-8")


# -- from the tree to the model -----------------------------------------------------------------------------------


@dataclass
class _Mesh:
    """What a constraint needs to know of the model."""

    nodes: np.ndarray
    elements: np.ndarray
    element_type: str
    duration_s: float


def _read_nodes(element: Element) -> np.ndarray:
    if element.attributes.get("DOF", "3").strip() != "3":
        raise InputError(f"{element.place}: expected nodes of DOF 3, got '{element.attributes['DOF']}'")
    count = _whole_attribute(element, "NumNodes", 1)
    return element.numbers(float, 3 * count, f"{count} nodes of 3 coordinates").reshape(count, 3)


def _read_elements(element: Element, nodes: np.ndarray) -> tuple[np.ndarray, str]:
    element_type = element.attribute("Type", tuple(NODES_OF))
    count, corners = _whole_attribute(element, "NumEls", 1), NODES_OF[element_type]
    elements = element.numbers(int, count * corners, f"{count} elements of {corners} nodes").reshape(count, corners)
    _check_indices(element, elements, len(nodes), "node")
    ordered = np.sort(elements, axis=1)
    repeated = (ordered[:, 1:] == ordered[:, :-1]).any(1)
    if repeated.any():
        first = int(np.argmax(repeated))
        raise InputError(
            f"{element.line_of(first * corners)}: expected {corners} different nodes in an element, "
            f"got {elements[first].tolist()} in element {first}"
        )
    V = volumes(nodes, elements)
    if not (V > 0).all():
        first = int(np.argmax(~(V > 0)))
        state = "no volume" if V[first] == 0 else f"a negative volume of {V[first]:.3g} m3"
        raise InputError(
            f"{element.line_of(first * corners)}: expected elements of positive volume, got {state} in element "
            f"{first}, {(~(V > 0)).sum()} such in all; check the order of its nodes and for coinciding nodes"
        )
    return elements, element_type


def _check_indices(element: Element, indices: np.ndarray, count: int, what: str) -> None:
    outside = ((indices < 0) | (indices >= count)).ravel()
    if outside.any():
        first = int(np.argmax(outside))
        raise InputError(
            f"{element.line_of(first)}: expected {what} numbers from 0 to {count - 1} in <{element.tag}>, "
            f"got {indices.ravel()[first]}"
        )


def _check_switches(system: Element) -> None:
    """Contact and reduced order are off where they say 0; the settings of contact alone switch nothing on."""
    for tag in ("ROM", "DoDeformableCollision", "DoSelfCollision"):
        switch = system.find(tag)
        if switch is not None and switch.number() != 0:
            what = "reduced-order models" if tag == "ROM" else "contact"
            raise InputError(f"{switch.place}: <{tag}> is not supported, this solver has no {what}; set it to 0")


def _read_materials(root: Element, count: int, density: Element | None) -> tuple[tuple[Material, ...], np.ndarray]:
    sets = root.all("ElementSet")
    if not sets:
        root.need("ElementSet")
    material_of = np.full(count, -1)
    for index, one in enumerate(sets):
        members = _element_set(one, count)
        twice = members[material_of[members] >= 0]
        if len(twice) or len(np.unique(members)) < len(members):
            what = f"element {twice[0]} in two" if len(twice) else "an element twice"
            raise InputError(f"{one.place}: expected every element in one <ElementSet>, got {what}")
        material_of[members] = index
    if (material_of < 0).any():
        raise InputError(
            f"{sets[-1].place}: expected every element in an <ElementSet>, got element {np.argmax(material_of < 0)} "
            f"in none and {(material_of < 0).sum()} such in all"
        )
    return tuple(_read_material(one.need("Material"), density) for one in sets), material_of


def _element_set(element: Element, count: int) -> np.ndarray:
    if element.attribute("Size") == "all":
        return np.arange(count)
    size = _whole_attribute(element, "Size", 1)
    return _run(element, size, count, "element")


def _run(element: Element, size: int, count: int, what: str) -> np.ndarray:
    """The numbers listed, or `size` consecutive ones where only the first is given; all of them below `count`."""
    if size > count:
        raise InputError(f"{element.place}: expected a set of at most {count} {what} numbers, got one of {size}")
    listed = element.numbers(int, None, f"{size} {what} numbers, or the first of them,")
    if len(listed) == 1:
        listed = listed[0] + np.arange(size)
    if len(listed) != size:
        raise InputError(
            f"{element.place}: expected {size} {what} numbers, or the first of them, in <{element.tag}>, "
            f"got {len(listed)}"
        )
    _check_indices(element, listed, count, what)
    return listed


def _read_material(element: Element, density: Element | None) -> Material:
    kind = element.attribute("Type")
    if kind in _REFUSED_MATERIALS:
        raise InputError(f"{element.place}: material {kind} is not supported; use one of {choices(_MATERIALS)}")
    kind = element.attribute("Type", tuple(_MATERIALS))
    elastic, own = element.need("ElasticParams"), element.find("Density")
    if own is None and density is None:
        raise InputError(
            f"{element.place}: expected a <Density> in <Material> or in <SystemParams>, got none; "
            "soft tissue has about 1050 kg/m3"
        )
    count = _whole_attribute(elastic, "NumParams", 0)
    if count != 2:
        raise InputError(f"{elastic.place}: expected NumParams to be 2 for material {kind}, got {count}")
    parameters = elastic.numbers(float, 2, f"2 parameters of material {kind}").tolist()
    density_kg_m3 = _positive(own or density, "a density in kg/m3")
    visco = element.need("ViscoParams") if kind == "NHV" else element.find("ViscoParams")
    if kind != "NHV":
        if visco is not None:
            raise InputError(f"{visco.place}: material {kind} has no <ViscoParams>; use NHV or take them out")
        with _at(elastic.place):
            return _MATERIALS[kind](*parameters, density_kg_m3)
    isochoric, volumetric = (_whole_attribute(visco, name, 0) for name in ("NumIsoTerms", "NumVolTerms"))
    terms = visco.numbers(
        float, 2 * (isochoric + volumetric), f"{isochoric + volumetric} pairs of a modulus ratio and a time in s"
    )
    pairs = tuple(tuple(pair) for pair in terms.reshape(-1, 2).tolist())
    with _at(element.place):
        return ViscoNeoHookean(*parameters, density_kg_m3, pairs[:isochoric], pairs[isochoric:])


def _read_constraint(element: Element, mesh: _Mesh) -> list[Load]:
    kind = element.attribute("Type")
    if kind == "Traction":
        raise InputError(f"{element.place}: Traction constraints are not supported; use Pressure or Force")
    element.attribute("Type", _CONSTRAINTS)
    by_normal = element.attributes.get("SpecType", "").strip() == "NORMAL"
    for region in element.all("RestrictTo"):
        if kind == "Pressure" or not by_normal:
            raise InputError(f"{region.place}: <RestrictTo> works on nodes of SpecType NORMAL alone; take it out")
    if kind == "Fix":
        return [Fixed(_read_node_set(element, mesh), _axes(element))]
    shape = LoadShape(element.attribute("LoadShape", LOAD_SHAPES), mesh.duration_s)
    if kind == "Pressure":
        return [Pressure(_read_faces(element, mesh), element.need("Magnitude").number(), shape)]
    if kind == "Gravity":
        everywhere = element.attributes.get("NumNodes", "").strip() == "all"
        nodes = None if everywhere else _read_node_set(element, mesh)
        acceleration, given = element.need("AccelerationMagnitude").number(), element.need("AccelerationDirection")
        direction = given.numbers(float, 3, "a direction of 3 numbers")
        with _at(given.place):
            return [Gravity(acceleration, direction, shape, nodes)]
    nodes = _read_node_set(element, mesh)
    magnitudes = element.need("Magnitudes")
    uniform = magnitudes.attribute("Type", ("UNIFORM", "DIFFORM")) == "UNIFORM"
    values = magnitudes.numbers(
        float, 1 if uniform else len(nodes), "one number" if uniform else f"{len(nodes)} numbers"
    )
    load = Displacement if kind == "Disp" else Force
    return [load(nodes, axis, np.broadcast_to(values, nodes.shape), shape) for axis in _axes(element)]


def _axes(element: Element) -> tuple[int, ...]:
    if element.attributes.get("DOF", "all").strip() == "all":
        return (0, 1, 2)
    return (int(element.attribute("DOF", ("0", "1", "2", "all"))),)


def _read_node_set(element: Element, mesh: _Mesh) -> np.ndarray:
    if element.attributes.get("SpecType", "NODES").strip() != "NODES":
        element.attribute("SpecType", ("NODES", "NORMAL"))
        return _restrict(np.unique(_faces_along_normal(element, mesh)), element, mesh)
    if element.attribute("NumNodes") == "all":
        return np.arange(len(mesh.nodes))
    size = _whole_attribute(element, "NumNodes", 1)
    listing = element.need("Nodes")
    nodes = _run(listing, size, len(mesh.nodes), "node")
    if len(np.unique(nodes)) < size:
        ordered = np.sort(nodes)
        raise InputError(
            f"{listing.place}: expected every node once in a constraint, got node "
            f"{ordered[:-1][ordered[1:] == ordered[:-1]][0]} twice"
        )
    return nodes


def _restrict(nodes: np.ndarray, element: Element, mesh: _Mesh) -> np.ndarray:
    for region in element.all("RestrictTo"):
        if region.attribute("Type", ("Box", "Sphere")) == "Box":
            bounds = region.numbers(float, 6, "6 numbers, the least and greatest x, y and z").reshape(3, 2)
            inside = ((mesh.nodes[nodes] >= bounds[:, 0]) & (mesh.nodes[nodes] <= bounds[:, 1])).all(1)
        else:
            radius, *centre = region.numbers(float, 4, "4 numbers, radius and centre,")
            inside = np.linalg.norm(mesh.nodes[nodes] - centre, axis=1) < radius
        nodes = nodes[inside]
        if not len(nodes):
            raise InputError(f"{region.place}: expected the constraint to hold some nodes, got an empty set")
    return nodes


def _read_faces(element: Element, mesh: _Mesh) -> np.ndarray:
    corners = 4 if mesh.element_type == "H8" else 3
    if element.attributes.get("SpecType", "").strip() == "NORMAL":
        return _faces_along_normal(element, mesh)
    if element.attribute("NumFaces") == "all":
        return _boundary_faces(mesh)
    if element.attribute("FaceType", ("Quad", "Tri")) != ("Quad" if corners == 4 else "Tri"):
        raise InputError(
            f"{element.place}: expected faces of {corners} nodes on {mesh.element_type} elements, "
            f"got FaceType {element.attribute('FaceType')}"
        )
    count, listing = _whole_attribute(element, "NumFaces", 1), element.need("Faces")
    faces = listing.numbers(int, count * corners, f"{count} faces of {corners} nodes").reshape(count, corners)
    _check_indices(listing, faces, len(mesh.nodes), "node")
    return faces


def _faces_along_normal(element: Element, mesh: _Mesh) -> np.ndarray:
    """Outer faces whose normal is less than the tolerance angle away from the one given."""
    given = element.need("Normal")
    normal = given.numbers(float, 3, "a normal of 3 numbers")
    try:
        tolerance = float(given.attribute("ToleranceAngle"))
    except ValueError:
        tolerance = math.nan
    if not 0 <= tolerance <= 180:
        raise InputError(
            f"{given.place}: expected a ToleranceAngle from 0 to 180 degrees, "
            f"got '{short(given.attribute('ToleranceAngle'))}'"
        )
    if not np.linalg.norm(normal) > 0:
        raise InputError(f"{given.place}: expected a normal of some length, got {normal.tolist()}")
    faces = _boundary_faces(mesh)
    areas = _area_vectors(mesh.nodes, faces)
    cosine = areas @ normal / (np.linalg.norm(areas, axis=1) * np.linalg.norm(normal))
    faces = faces[np.degrees(np.arccos(np.clip(cosine, -1, 1))) < tolerance]
    if not len(faces):
        raise InputError(
            f"{given.place}: expected outer faces along the normal, got an empty set; widen ToleranceAngle"
        )
    return faces


_FACES = {
    8: ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    4: ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
}


def _boundary_faces(mesh: _Mesh) -> np.ndarray:
    """(F, 4) or (F, 3) node numbers of the faces that one element alone has, normals outwards."""
    faces = mesh.elements[:, np.array(_FACES[mesh.elements.shape[1]])].reshape(
        -1, 4 if mesh.element_type == "H8" else 3
    )
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]


def _area_vectors(nodes: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3) m2: half the cross product of two edges of a triangle, of the diagonals of a quadrilateral."""
    corner = nodes[faces]
    if faces.shape[1] == 4:
        return np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1]) / 2
    return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) / 2


def _variable(element: Element) -> str:
    name = element.text().strip()
    if name not in VARIABLES:
        raise InputError(
            f"{element.place}: expected <Variable> to be {choices(VARIABLES)}, got {nearest(name, VARIABLES)}"
        )
    return name


def _whole_attribute(element: Element, name: str, least: int) -> int:
    text = element.attribute(name)
    if not (text.isascii() and text.isdigit() and int(text) >= least):
        raise InputError(
            f"{element.place}: expected {name} to be a whole number of at least {least}, got '{short(text)}'"
        )
    return int(text)


def _positive(element: Element, what: str) -> float:
    value = element.number()
    if value <= 0:
        raise InputError(f"{element.place}: expected {what} above 0 in <{element.tag}>, got {value:g}")
    return value


def _not_negative(element: Element, what: str) -> float:
    value = element.number()
    if value < 0:
        raise InputError(f"{element.place}: expected {what} of 0 or more in <{element.tag}>, got {value:g}")
    return value


@contextmanager
def _at(place: str):
    """Give an error the place in the file that it lacks."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}: {error}") from None


def _check_text(element: Element) -> None:
    if element.tag in _HOLDERS and element.text().strip():
        raise InputError(
            f"{element.line_of(0)}: expected tags in <{element.tag}>, got the text '{short(element.text())}'"
        )
    for child in element.children:
        _check_text(child)


def _check_tag(element: Element, parent: Element | None) -> None:
    tag = element.tag
    if parent is None:
        if tag != "Model":
            raise InputError(f"{element.place}: expected a NiftySim model in <Model>, got <{tag}>")
    elif tag in _REFUSED:
        raise InputError(
            f"{element.place}: <{tag}> is not supported, this solver has no {_REFUSED[tag]}; run this model in NiftySim"
        )
    elif tag not in _TAGS[parent.tag][1]:
        if tag in _TAGS:
            homes = [home for home, (_, inside) in _TAGS.items() if tag in inside]
            where = f"belongs in {choices([f'<{home}>' for home in homes])}" if homes else "must be the outermost tag"
            raise InputError(
                f"{element.place}: got <{tag}> in <{parent.tag}>, where it has no meaning; it {where}; "
                f"is <{parent.tag}> of line {parent.line} closed?"
            )
        raise InputError(
            f"{element.place}: unknown tag in <{parent.tag}>, got {nearest(tag, _TAGS[parent.tag][1], '<>')}"
        )
    elif tag not in _MANY and parent.find(tag) is not None:
        raise InputError(
            f"{element.place}: expected one <{tag}> in <{parent.tag}>, got a second; "
            f"the first is in line {parent.find(tag).line}"
        )
    for name in element.attributes:
        if name not in _TAGS[tag][0]:
            raise InputError(f"{element.place}: unknown attribute in <{tag}>, got {nearest(name, _TAGS[tag][0])}")


# -- from the model to text ---------------------------------------------------------------------------------------


def _rows(table: np.ndarray) -> list[str]:
    return [" ".join(map(repr, row)) for row in table.tolist()]


def _wrapped(numbers: np.ndarray) -> list[str]:
    return [" ".join(map(repr, numbers[start : start + 16].tolist())) for start in range(0, len(numbers), 16)]


def _material_lines(material: Material, members: np.ndarray, count: int) -> list[str]:
    if not len(members):
        return []  # NiftySim has no place for a material that nothing is made of
    kind = next(kind for kind, known in _MATERIALS.items() if type(material) is known)
    parameters = (material.young_pa, material.poisson) if kind == "LE" else (material.shear_pa, material.bulk_pa)
    lines = [
        f'  <ElementSet Size="{"all" if len(members) == count else len(members)}">',
        f'    <Material Type="{kind}">',
        f'      <ElasticParams NumParams="2">{" ".join(repr(float(p)) for p in parameters)}</ElasticParams>',
    ]
    if kind == "NHV":
        terms = [repr(float(number)) for pair in (*material.isochoric, *material.volumetric) for number in pair]
        lines += [
            f'      <ViscoParams NumIsoTerms="{len(material.isochoric)}" NumVolTerms="{len(material.volumetric)}">'
            f"{' '.join(terms)}</ViscoParams>"
        ]
    lines += [f"      <Density>{float(material.density)!r}</Density>", "    </Material>"]
    return lines + (["0"] if len(members) == count else _wrapped(members)) + ["  </ElementSet>"]


def _constraint_lines(load: Load, model: Model) -> list[str]:
    if isinstance(load, Fixed):
        whole = set(load.axes) == {0, 1, 2}
        return [
            line
            for axis in (["all"] if whole else load.axes)
            for line in _constraint("Fix", load.nodes, [], f' DOF="{axis}"')
        ]
    if not (isinstance(load.shape, LoadShape) and load.shape.duration_s == model.duration_s):
        raise InputError(
            f"expected a load shape of {choices(LOAD_SHAPES)} over the whole duration of {model.duration_s} s, "
            f"which is all that NiftySim can express, got {short(repr(load.shape))}"
        )
    shape = f' LoadShape="{load.shape.name}"'
    if isinstance(load, Pressure):
        kind = "Quad" if load.faces.shape[1] == 4 else "Tri"
        return [
            f'  <Constraint Type="Pressure" NumFaces="{len(load.faces)}" FaceType="{kind}"{shape}>',
            "    <Faces>",
            *_rows(load.faces),
            "    </Faces>",
            f"    <Magnitude>{float(load.magnitude_pa)!r}</Magnitude>",
            "  </Constraint>",
        ]
    if isinstance(load, Gravity):
        inside = [
            f"    <AccelerationMagnitude>{float(load.acceleration)!r}</AccelerationMagnitude>",
            f"    <AccelerationDirection>{' '.join(map(repr, load.direction.tolist()))}</AccelerationDirection>",
        ]
        return _constraint("Gravity", load.nodes, inside, shape)
    kind, values = ("Disp", load.magnitudes_m) if isinstance(load, Displacement) else ("Force", load.magnitudes_n)
    if (values == values[0]).all():
        inside = [f'    <Magnitudes Type="UNIFORM">{float(values[0])!r}</Magnitudes>']
    else:
        inside = ['    <Magnitudes Type="DIFFORM">', *_wrapped(values), "    </Magnitudes>"]
    return _constraint(kind, load.nodes, inside, f' DOF="{load.axis}"{shape}')


def _constraint(kind: str, nodes: np.ndarray | None, inside: list[str], attributes: str) -> list[str]:
    count, listing = ("all", ["0"]) if nodes is None else (len(nodes), _wrapped(nodes))
    return [
        f'  <Constraint Type="{kind}" NumNodes="{count}"{attributes}>',
        "    <Nodes>",
        *listing,
        "    </Nodes>",
        *inside,
        "  </Constraint>",
    ]
