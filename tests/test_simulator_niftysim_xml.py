import dataclasses
import os
import re
from pathlib import Path

import numpy as np
import pytest

from simulator import elements
from simulator.curves import KeyFrames, LoadShape
from simulator.errors import InputError
from simulator.model import (
    Displacement,
    Fixed,
    Force,
    Gravity,
    Model,
    NeoHookean,
    Pressure,
    StVenantKirchhoff,
    ViscoNeoHookean,
)
from simulator.niftysim_xml import niftysim_times, read_niftysim, write_niftysim
from simulator.solver import solve

REFERENCE = (
    Path(os.environ.get("LIPMETRICS_REFERENCE", Path(__file__).resolve().parents[2] / "shared" / "reference"))
    / "niftysim"
)

TWO_HEXAHEDRA = """<?xml version="1.0" encoding="utf-8"?>
<Model>
  <!-- two cubes on top of each other -->
  <Nodes DOF="3" NumNodes="12">
0 0 0
1 0 0
1 1 0
0 1 0
0 0 1
1 0 1
1 1 1
0 1 1
0 0 2
1 0 2
1 1 2
0 1 2
  </Nodes>
  <Elements NumEls="2" Type="H8">
0 1 2 3 4 5 6 7
4 5 6 7 8 9 10 11
  </Elements>
  <ElementSet Size="all">
    <Material Type="NH">
      <ElasticParams NumParams="2">800 7000</ElasticParams>
    </Material>
    0
  </ElementSet>
  <Constraint Type="Fix" DOF="all" NumNodes="4">
    <Nodes>0</Nodes>
  </Constraint>
  <Constraint Type="Disp" DOF="2" NumNodes="4" LoadShape="RAMP">
    <Nodes>8 9
10 11</Nodes>
    <Magnitudes Type="UNIFORM">0.5</Magnitudes>
  </Constraint>
  <SystemParams>
    <TimeStep>0.001</TimeStep>
    <TotalTime>2</TotalTime>
    <DampingCoeff>5</DampingCoeff>
    <HGKappa>0.075</HGKappa>
    <Density>1000</Density>
  </SystemParams>
  <Output Freq="20">
    <Variable>U</Variable>
    <Variable>EKin</Variable>
  </Output>
</Model>
"""
FIX = TWO_HEXAHEDRA[TWO_HEXAHEDRA.index('  <Constraint Type="Fix"') : TWO_HEXAHEDRA.index('  <Constraint Type="Disp"')]
MATERIAL = TWO_HEXAHEDRA[TWO_HEXAHEDRA.index("  <ElementSet") : TWO_HEXAHEDRA.index(FIX)]


@pytest.fixture
def rng():
    return np.random.default_rng(55)


@pytest.fixture
def read(tmp_path):
    def read(text=TWO_HEXAHEDRA, *changes):
        for old, new in changes:
            assert text.count(old) >= 1, old
            text = text.replace(old, new, 1)
        path = tmp_path / "model.xml"
        path.write_text(text, encoding="utf-8")
        return read_niftysim(path)

    return read


def assert_equal(one, other):
    """Every field of two models, number for number."""
    assert type(one) is type(other)
    for field in dataclasses.fields(one):
        left, right = getattr(one, field.name), getattr(other, field.name)
        if field.name == "loads":
            assert len(left) == len(right)
            for a, b in zip(left, right, strict=True):
                assert_equal(a, b)
        elif isinstance(left, np.ndarray):
            assert left.dtype == right.dtype and np.array_equal(left, right), field.name
        else:
            assert left == right, field.name


# -- what is read -----------------------------------------------------------------------------------------------------


def test_every_number_of_a_small_model(read):
    model = read()
    corners = [[0, 0], [1, 0], [1, 1], [0, 1]]
    expected = Model(
        nodes=[[x, y, z] for z in range(3) for x, y in corners],
        elements=[range(8), range(4, 12)],
        materials=(NeoHookean(800.0, 7000.0, 1000.0),),
        loads=(
            Fixed(np.arange(4)),
            Displacement(np.arange(8, 12), 2, 0.5, LoadShape("RAMP", 2.0)),
        ),
        damping=5.0,
        hourglass=0.075,
        dt_s=0.001,
        duration_s=2.0,
        output_every=20,
        outputs=("U", "EKin"),
    )
    assert_equal(model, expected)


def test_saved_times_are_one_step_late(read):
    model = read(TWO_HEXAHEDRA, ("<TotalTime>2<", "<TotalTime>0.05<"))
    np.testing.assert_allclose(niftysim_times(model), [0.021, 0.041], rtol=1e-14)
    with pytest.raises(InputError, match="output_every"):
        niftysim_times(dataclasses.replace(model, output_every=None))


def test_without_output_and_hourglass_of_tetrahedra(read):
    text = TWO_HEXAHEDRA[: TWO_HEXAHEDRA.index("  <Output")] + "</Model>"
    text = text.replace("    <HGKappa>0.075</HGKappa>\n", "").replace('NumNodes="12"', 'NumNodes="4"')
    nodes = text[text.index("0 0 0\n") : text.index("  </Nodes>")]
    elements = text[text.index("0 1 2 3 4 5") : text.index("  </Elements>")]
    disp = text[text.index('  <Constraint Type="Disp"') : text.index("  <SystemParams>")]
    for old, new in [(nodes, "0 0 0 1 0 0 0 1 0 0 0 1\n"), (elements, "0 1 2 3\n"), (disp, "")]:
        text = text.replace(old, new)
    model = read(text, ('NumEls="2" Type="H8"', 'NumEls="1" Type="T4ANP"'))
    assert (model.element_type, model.hourglass, model.output_every, model.outputs) == ("T4ANP", 0, None, ("U",))


def test_several_materials_and_densities(read):
    sets = """
  <ElementSet Size="1"><Material Type="LE"><ElasticParams NumParams="2">3000 0.4</ElasticParams>
    <Density>1200</Density></Material>1</ElementSet>
  <ElementSet Size="1">0<Material Type="NHV"><ElasticParams NumParams="2">800 7000</ElasticParams>
    <ViscoParams NumIsoTerms="2" NumVolTerms="1">0.3 0.1 0.2 1 0.5 10</ViscoParams></Material></ElementSet>
"""
    model = read(TWO_HEXAHEDRA, (MATERIAL, sets))
    assert model.materials == (
        StVenantKirchhoff(3000.0, 0.4, 1200.0),
        ViscoNeoHookean(800.0, 7000.0, 1000.0, ((0.3, 0.1), (0.2, 1.0)), ((0.5, 10.0),)),
    )
    assert model.material_of.tolist() == [1, 0]


def test_a_set_listed_before_and_after_its_material(read):
    listed = MATERIAL.replace('Size="all">\n    <', 'Size="2">0<').replace("</Material>\n    0", "</Material>1")
    assert read(TWO_HEXAHEDRA, (MATERIAL, listed)).material_of.tolist() == [0, 0]


def test_a_set_given_by_its_first_element(read):
    assert read(TWO_HEXAHEDRA, ('<ElementSet Size="all">', '<ElementSet Size="2">')).material_of.tolist() == [0, 0]


def test_forces_per_node_and_on_all_axes(read):
    change = (
        (
            'Type="Disp" DOF="2" NumNodes="4" LoadShape="RAMP"',
            'Type="Force" NumNodes="4" LoadShape="POLY345"',
        ),
        ('"UNIFORM">0.5<', '"DIFFORM">1e-3 2 3 -4<'),
    )
    loads = read(TWO_HEXAHEDRA, *change).loads[1:]
    for axis, load in enumerate(loads):
        assert_equal(load, Force(np.arange(8, 12), axis, [1e-3, 2, 3, -4], LoadShape("POLY345", 2.0)))
    assert len(loads) == 3


@pytest.mark.parametrize("nodes", ['NumNodes="all">', 'NumNodes="4"><Nodes>8</Nodes>'])
def test_gravity_everywhere_and_somewhere(read, nodes):
    gravity = f"""<Constraint Type="Gravity" LoadShape="STEP" {nodes}
      <AccelerationMagnitude>9.81</AccelerationMagnitude><AccelerationDirection>0 3 -4</AccelerationDirection>
      </Constraint>"""
    load = read(TWO_HEXAHEDRA, (FIX, FIX + gravity)).loads[1]
    expected = Gravity(9.81, [0, 0.6, -0.8], LoadShape("STEP", 2.0), None if "all" in nodes else np.arange(8, 12))
    assert_equal(load, expected)


@pytest.mark.parametrize(
    "normal, restrict, nodes",
    [
        ('ToleranceAngle="10">0 0 -2', "", [0, 1, 2, 3]),
        ('ToleranceAngle="10">1 0 0', "", [1, 2, 5, 6, 9, 10]),
        ('ToleranceAngle="60">1 1 0', "", [1, 2, 3, 5, 6, 7, 9, 10, 11]),
        ('ToleranceAngle="10">1 0 0', '<RestrictTo Type="Box">0 2 0 2 0.5 1.5</RestrictTo>', [5, 6]),
        (
            'ToleranceAngle="10">1 0 0',
            '<RestrictTo Type="Box">0 2 0 2 0.5 3</RestrictTo><RestrictTo Type="Sphere">1.2 1 0 1</RestrictTo>',
            [5, 6, 9],
        ),
    ],
)
def test_nodes_by_the_normal_of_their_faces(read, normal, restrict, nodes):
    fix = f'<Constraint Type="Fix" DOF="0" SpecType="NORMAL"><Normal {normal}</Normal>{restrict}</Constraint>'
    load = read(TWO_HEXAHEDRA, (FIX, FIX + fix)).loads[1]
    assert_equal(load, Fixed(np.array(nodes), (0,)))


def area_vectors(nodes, faces):
    a, b, c, d = np.moveaxis(nodes[faces], 1, 0)
    return np.cross(c - a, d - b) / 2


def test_faces_of_a_pressure(read):
    def faces(attributes, inside=""):
        pressure = (
            f'<Constraint Type="Pressure" LoadShape="RAMP" {attributes}>{inside}<Magnitude>250</Magnitude></Constraint>'
        )
        load = read(TWO_HEXAHEDRA, (FIX, FIX + pressure)).loads[1]
        assert isinstance(load, Pressure) and load.magnitude_pa == 250
        return load.faces

    nodes = read().nodes
    assert faces('NumFaces="1" FaceType="Quad"', "<Faces>8 9 10 11</Faces>").tolist() == [[8, 9, 10, 11]]
    top = faces('SpecType="NORMAL"', '<Normal ToleranceAngle="5">0 0 1</Normal>')
    np.testing.assert_allclose(area_vectors(nodes, top), [[0, 0, 1]])
    every = faces('NumFaces="all"')
    areas = area_vectors(nodes, every)
    assert len(every) == 10
    volume = np.einsum("fi,fi->", areas, nodes[every].mean(1)) / 3  # divergence theorem: all normals point outwards
    assert volume == pytest.approx(2) and np.allclose(areas.sum(0), 0)


def test_outer_faces_of_tetrahedra_point_outwards(read, tmp_path, rng):
    model = read_niftysim(
        tetrahedra(
            tmp_path,
            '<Constraint Type="Pressure" NumFaces="all" LoadShape="STEP"><Magnitude>1</Magnitude></Constraint>',
        )
    )
    faces = model.loads[-1].faces
    a, b, c = np.moveaxis(model.nodes[faces], 1, 0)
    areas = np.cross(b - a, c - a) / 2
    assert len(faces) == 6 and np.allclose(areas.sum(0), 0)
    assert np.einsum("fi,fi->", areas, (a + b + c) / 3) / 3 == pytest.approx(2 / 6)


def tetrahedra(folder, constraint):
    """Two tetrahedra that share a face."""
    path = folder / "tetrahedra.xml"
    path.write_text(
        '<Model><Nodes DOF="3" NumNodes="5">0 0 0 1 0 0 0 1 0 0 0 1 0 0 -1</Nodes>'
        '<Elements NumEls="2" Type="T4">0 1 2 3 0 2 1 4</Elements>'
        + MATERIAL
        + FIX
        + constraint
        + TWO_HEXAHEDRA[TWO_HEXAHEDRA.index("  <SystemParams>") :]
    )
    return path


def test_switches_at_zero_and_settings_of_contact_alone_are_read_over(read):
    extra = "<ROM>0</ROM><DoDeformableCollision>0</DoDeformableCollision><BVType>AABB</BVType></SystemParams>"
    assert_equal(read(TWO_HEXAHEDRA, ("</SystemParams>", extra)), read())


# -- what is refused --------------------------------------------------------------------------------------------------

FAULTS = {
    "not XML": ([(TWO_HEXAHEDRA, "solid bone\n facet")], "line 1: .* in XML, but it is malformed"),
    "empty": ([(TWO_HEXAHEDRA, "")], "line 1: .*no element found"),
    "unclosed": (
        [("  </Nodes>\n", "")],
        "line 17: got <Elements> in <Nodes>, .* in <Model>; is <Nodes> of line 4 closed?",
    ),
    "cut off": ([("  <Output Freq", "<!--")], "line 43: .* with <Model> of line 2 open"),
    "other root": ([(TWO_HEXAHEDRA, "<html/>")], "line 1: .* in <Model>, got <html>"),
    "unknown tag": (
        [("<Nodes DOF", "<Nodse DOF")],
        "line 4: unknown tag in <Model>, got <Nodse>; did you mean <Nodes>?",
    ),
    "tag of unlike name": ([("  <Output", "  <Zebra/>\n  <Output")], "line 43: unknown tag in <Model>, got <Zebra>$"),
    "tag elsewhere": (
        [("  <SystemParams>", "  <TimeStep>1</TimeStep>\n  <SystemParams>")],
        "line 36: got <TimeStep> in <Model>, .* belongs in <SystemParams>",
    ),
    "contact": (
        [("  <Output", "  <ContactPlate/>\n  <Output")],
        "line 43: <ContactPlate> is not supported, .* no contact",
    ),
    "submodel": ([("  <Output", "  <SubModel/>\n  <Output")], "<SubModel> is not supported"),
    "reduced order": ([("</SystemParams>", "<ROM>1</ROM></SystemParams>")], "line 42: <ROM> .* set it to 0"),
    "unknown attribute": ([("LoadShape=", "LoadShap=")], "line 31: unknown attribute .* did you mean 'LoadShape'"),
    "missing attribute": (
        [(' LoadShape="RAMP"', "")],
        'line 31: expected an attribute LoadShape="..." in <Constraint>',
    ),
    "missing element type": ([(' Type="H8"', "")], 'line 18: expected an attribute Type="..."'),
    "wrong element type": ([("H8", "H20")], "line 18: expected Type to be H8, T4 or T4ANP, got 'H20'"),
    "no nodes": (
        [("<Nodes DOF", "<!--<Nodes DOF"), ("</Nodes>", "</Nodes>-->")],
        "line 2: expected a <Nodes> in <Model>",
    ),
    "second nodes": (
        [("<Elements", '<Nodes DOF="3" NumNodes="1">0 0 0</Nodes>\n<Elements')],
        "line 18: .* first .* line 4",
    ),
    "no material": ([(MATERIAL, "")], "line 2: expected a <ElementSet>"),
    "no time step": ([("<TimeStep>0.001</TimeStep>", "")], "line 36: expected a <TimeStep> in <SystemParams>"),
    "no damping": ([("<DampingCoeff>5</DampingCoeff>", "")], "line 36: expected a <DampingCoeff>"),
    "no hourglass stiffness": ([("<HGKappa>0.075</HGKappa>", "")], "line 36: expected a <HGKappa>"),
    "no density": (
        [("<Density>1000</Density>", "")],
        "line 23: expected a <Density> in <Material> or in <SystemParams>",
    ),
    "no output frequency": ([(' Freq="20"', "")], 'line 43: expected an attribute Freq="..."'),
    "output frequency of 0": ([('"20"', '"0"')], "line 43: expected Freq to be a whole number of at least 1, got '0'"),
    "wrong output": ([(">EKin<", ">Ekin<")], "line 45: .* got 'Ekin'; did you mean 'EKin'"),
    "too few coordinates": ([("1 1 2\n", "1 1\n")], "line 4: expected 12 nodes of 3 coordinates .*, got 35 numbers"),
    "too few element nodes": ([(" 10 11\n", " 10\n")], "line 18: expected 2 elements of 8 nodes .*, got 15 numbers"),
    "not a number": ([("1 1 2\n", "1 1 two\n")], "line 15: expected finite numbers in <Nodes>, got 'two'"),
    "NaN": ([("1 1 2\n", "1 nan 2\n")], "line 15: expected finite numbers in <Nodes>, got 'nan'"),
    "a fraction as node": ([("4 5 6 7 8", "4 5 6.5 7 8")], "line 20: expected whole numbers in <Elements>, got '6.5'"),
    "a huge node": ([("9 10 11\n", f"9 10 {10**400}\n")], "line 20: expected whole numbers in <Elements>, got '1000"),
    "node out of range": ([("9 10 11\n", "9 10 12\n")], "line 20: expected node numbers from 0 to 11 .*, got 12"),
    "negative node": ([("9 10 11\n", "9 10 -1\n")], "line 20: expected node numbers from 0 to 11 .*, got -1"),
    "constraint node out of range": ([("10 11<", "10 12<")], "line 33: expected node numbers from 0 to 11 .*, got 12"),
    "run out of range": ([("<Nodes>0<", "<Nodes>9<")], "expected node numbers from 0 to 11"),
    "same node twice": ([("10 11<", "10 10<")], "line 32: expected every node once .*, got node 10 twice"),
    "element with a node twice": ([("9 10 11\n", "9 10 10\n")], "line 20: expected 8 different nodes .* element 1"),
    "inverted element": (
        [("4 5 6 7 8 9 10 11", "8 9 10 11 4 5 6 7")],
        "line 20: .* positive volume, got a negative volume of -1 m3 in element 1",
    ),
    "flat element": ([("0 0 2\n1 0 2\n1 1 2\n0 1 2\n", "0 0 1\n1 0 1\n1 1 1\n0 1 1\n")], "line 20: .* got no volume"),
    "loose node": ([('"12"', '"13"'), ("0 1 2\n", "0 1 2\n9 9 9\n")], "line 17: .* got node 12 in none"),
    "empty node set": (
        [('NumNodes="4" LoadShape', 'NumNodes="0" LoadShape')],
        "line 31: expected NumNodes .* at least 1",
    ),
    "empty node list": ([("<Nodes>0</Nodes>", "<Nodes/>")], "line 29: expected 4 node numbers, .* got 0 numbers"),
    "wrong node count": (
        [('NumNodes="4" LoadShape', 'NumNodes="3" LoadShape')],
        "line 32: expected 3 node numbers.*, got 4",
    ),
    "wrong node total": ([('"12"', '"twelve"')], "line 4: expected NumNodes to be a whole number"),
    "empty element set": ([('Size="all"', 'Size="0"')], "line 22: expected Size .* at least 1"),
    "elements left out": ([('Size="all"', 'Size="1"')], "line 22: .* got element 1 in none and 1 such in all"),
    "elements twice": ([(MATERIAL, MATERIAL * 2)], "line 28: .* got element 0 in two"),
    "element out of range": (
        [('"all">', '"1">'), ("    0\n", "    2\n")],
        "line 26: expected element numbers from 0 to 1",
    ),
    "a set beyond the mesh": ([('Size="all"', f'Size="{10**30}"')], "line 22: expected a set of at most 2 element"),
    "unknown material": ([('"NH"', '"NHX"')], "line 23: expected Type to be NH, NHV or LE, got 'NHX'; did you mean"),
    "material not supported": ([('"NH"', '"TI"')], "line 23: material TI is not supported"),
    "parameter count": ([("800 7000", "800")], "line 24: expected 2 parameters of material NH .*, got 1 numbers"),
    "parameter announced": ([('NumParams="2"', 'NumParams="5"')], "line 24: expected NumParams to be 2"),
    "negative modulus": ([("800 7000", "-800 7000")], "line 24: .* above 0, got shear_pa=-800"),
    "no viscous terms": ([('"NH"', '"NHV"')], "line 23: expected a <ViscoParams>"),
    "magnitude count": ([('"UNIFORM">0.5', '"DIFFORM">0.5')], "line 34: expected 4 numbers in <Magnitudes>, got 1"),
    "magnitude NaN": ([(">0.5<", ">NaN<")], "line 34: expected finite numbers in <Magnitudes>, got 'NaN'"),
    "magnitude type": ([("UNIFORM", "FILE")], "line 34: expected Type to be UNIFORM or DIFFORM, got 'FILE'"),
    "load shape": (
        [("RAMP", "RAMPHLD")],
        "line 31: expected LoadShape to be .*, got 'RAMPHLD'; did you mean 'RAMPHOLD'",
    ),
    "axis": ([('DOF="2"', 'DOF="3"')], "line 31: expected DOF to be 0, 1, 2 or all, got '3'"),
    "constraint type": ([('"Disp"', '"Dsip"')], "line 31: .* got 'Dsip'; did you mean 'Disp'"),
    "traction": ([('"Disp"', '"Traction"')], "line 31: Traction constraints are not supported"),
    "step of 0": ([(">0.001<", ">0<")], "line 37: expected a time step in s above 0 in <TimeStep>, got 0"),
    "negative step": ([(">0.001<", ">-1<")], "line 37: expected a time step in s above 0 in <TimeStep>, got -1"),
    "step above the total": ([(">0.001<", ">3<")], "line 37: expected a time step below the total time"),
    "no number as step": ([(">0.001<", "><")], "line 37: expected one number in <TimeStep>, got 0 numbers"),
    "negative density": ([(">1000<", ">-1<")], "line 41: expected a density in kg/m3 above 0"),
    "stray text": (
        [("<SystemParams>", "<SystemParams>\n 12")],
        "line 37: expected tags in <SystemParams>, got the text '12'",
    ),
    "no such normal": (
        [(FIX, '<Constraint Type="Fix" SpecType="NORMAL"><Normal ToleranceAngle="1">1 1 1</Normal></Constraint>')],
        "line 28: .* got an empty set; widen",
    ),
    "two dimensions": ([('DOF="3"', 'DOF="2"')], "line 4: expected nodes of DOF 3"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_one_sentence_with_file_and_line(read, fault):
    changes, message = FAULTS[fault]
    with pytest.raises(InputError, match=message) as caught:
        read(TWO_HEXAHEDRA, *changes)
    assert "model.xml, line " in str(caught.value) and "\n" not in str(caught.value)


def test_damaged_files_are_read_or_refused_in_one_sentence(read, rng):
    """Words left out, doubled, swapped or replaced: whatever comes, never another error."""
    words = re.findall(r"\s+|[^\s<>\"=]+|.", TWO_HEXAHEDRA)
    odd = [
        "",
        "-1",
        "1e400",
        "nan",
        "9" * 20,
        "<",
        "&",
        "\0",
        "é",
        "0x10",
        "all",
        "²",
        "T4",
        "NHV",
        "<Nodes>",
        "--",
        "'",
    ]
    refused = 0
    for _ in range(300):
        damaged = list(words)
        for place in rng.integers(0, len(words), 2):
            damaged[place] = rng.choice([*odd, damaged[place] * 2, words[rng.integers(len(words))]])
        try:
            read("".join(damaged))
        except InputError as error:
            refused += 1
            assert "model.xml, line " in str(error) and "\n" not in str(error)
    assert refused > 200


def test_no_entities_and_nothing_from_outside(read, tmp_path):
    (tmp_path / "secret.txt").write_text("0 0 0")
    for declaration in ('<!ENTITY x SYSTEM "secret.txt">', '<!ENTITY x "0 0 0">'):
        with pytest.raises(InputError, match=r"line 2: .* document type declaration"):
            read(TWO_HEXAHEDRA, ("<Model>", f"<!DOCTYPE Model [{declaration}]><Model>"), ("0 0 0", "&x;"))


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match=r"a NiftySim model, got .*none\.xml: No such file"):
        read_niftysim(tmp_path / "none.xml")
    with pytest.raises(InputError, match="Is a directory"):
        read_niftysim(tmp_path)
    (tmp_path / "odd.xml").write_bytes(b'<?xml version="1.0" encoding="klingon"?><Model/>')
    with pytest.raises(InputError, match="encoding"):
        read_niftysim(tmp_path / "odd.xml")


# -- what is written --------------------------------------------------------------------------------------------------


def test_a_rich_model_reads_back_equal(tmp_path, rng):
    small = rng.uniform(-0.1, 0.1, (12, 3))
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    nodes = np.array([[x, y, z] for z in range(3) for x, y in corners]) + small
    shape = LoadShape("HILLY", 0.3)
    model = Model(
        nodes=nodes,
        elements=[range(8), range(4, 12)],
        materials=(
            ViscoNeoHookean(801.5, 7000 / 3, 1051.0, ((0.3, 0.1),), ((0.1, 1 / 3), (0.2, 5.0))),
            StVenantKirchhoff(1e4 / 7, 0.49, 990.0),
        ),
        material_of=[1, 0],
        loads=(
            Fixed([0, 3, 1]),
            Fixed([2], (1,)),
            Displacement([4, 5], 1, rng.normal(size=2), shape),
            Force([6], 0, 1 / 3, shape),
            Gravity(9.81, [0, 0, -1], shape),
            Gravity(1.62, [1, 0, 0], shape, [7, 8]),
            Pressure([[8, 9, 10, 11]], -20.0, shape),
        ),
        damping=0.1,
        hourglass=0.3,
        dt_s=1e-5,
        duration_s=0.3,
        output_every=7,
        outputs=("U", "F"),
    )
    write_niftysim(model, tmp_path / "new" / "model.xml")
    assert_equal(read_niftysim(tmp_path / "new" / "model.xml"), model)


def test_a_direction_reads_back_the_same_to_the_last_bits(read, tmp_path, rng):
    for direction in rng.normal(size=(20, 3)):
        model = dataclasses.replace(read(), loads=(Gravity(9.81, direction, LoadShape("STEP", 2.0)),))
        write_niftysim(model, tmp_path / "model.xml")
        (again,) = read_niftysim(tmp_path / "model.xml").loads
        assert_equal(again, model.loads[0])


@pytest.mark.parametrize(
    "change, message",
    [
        ({"dt_s": "auto"}, "got dt_s='auto'"),
        ({"loads": (Force([0], 0, 1.0, KeyFrames((0, 1), (0, 1), ("linear",))),)}, "got KeyFrames"),
        ({"loads": (Force([0], 0, 1.0, LoadShape("RAMP", 1.0)),)}, "whole duration of 2.0 s"),
    ],
)
def test_what_niftysim_cannot_express(read, tmp_path, change, message):
    with pytest.raises(InputError, match=message):
        write_niftysim(dataclasses.replace(read(), **change), tmp_path / "out.xml")
    assert not (tmp_path / "out.xml").exists()


# -- NiftySim's own results -------------------------------------------------------------------------------------------

needs_reference = pytest.mark.skipif(
    not REFERENCE.is_dir(),
    reason="reference data absent; set LIPMETRICS_REFERENCE or put them in ../shared/reference",
)
NAMES = sorted(path.stem for path in REFERENCE.glob("*.xml"))
QUICK = ("h8_4x4x8_force", "t4_4x4x8_clamped_compress", "t4anp_4x4x8_clamped_compress")  # one of each element


@needs_reference
def test_all_reference_models_are_there():
    assert len(NAMES) == 14


@pytest.mark.parametrize("name", NAMES)
def test_reference_models_read_as_niftysim_read_them(name, tmp_path):
    model, stored = read_niftysim(REFERENCE / f"{name}.xml"), np.load(REFERENCE / f"{name}.npz")
    assert np.array_equal(model.nodes, stored["nodes"]) and np.array_equal(model.elements, stored["elements"])
    np.testing.assert_allclose(niftysim_times(model), stored["time_U"], rtol=1e-12)
    write_niftysim(model, tmp_path / "copy.xml")
    assert_equal(read_niftysim(tmp_path / "copy.xml"), model)


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in NAMES]
)
def test_motion_of_reference_models(name):
    """Displacements as NiftySim in double precision saved them; F, S and E there belong to one step before."""
    model, stored = read_niftysim(REFERENCE / f"{name}.xml"), np.load(REFERENCE / f"{name}.npz")
    times = niftysim_times(model)
    steps = np.rint(times / model.dt_s)
    saved = np.union1d(steps - 1, steps)
    u = solve(model, saved * model.dt_s, threads=1).displacements
    before, after = u[np.isin(saved, steps - 1)], u[np.isin(saved, steps)]
    assert relative_l2(after, stored["U"]) < 1e-5
    if name == "h8_4x4x8_NHV":
        return  # its forces depend on the past
    forces = [
        elements.internal_forces(
            model.nodes, model.elements, model.element_type, model.materials, model.material_of, model.hourglass, u
        )
        for u in before
    ]
    assert relative_l2(forces, stored["F_internal"]) < 1e-4
    if model.element_type == "T4ANP":
        return  # its stress is that of an averaged deformation gradient
    F = np.array([elements.deformation_gradients(model.nodes, model.elements, u) for u in before])
    E = (np.swapaxes(F, -1, -2) @ F - np.eye(3)) / 2
    S = np.linalg.inv(F) @ model.materials[0].stress(F)
    six = [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]  # NiftySim's order: 11 22 33 12 23 13
    assert relative_l2(E[..., *six], stored["E_green"], floor=1e-9) < 1e-4
    assert relative_l2(S[..., *six], stored["S_pk2"], floor=1e-9 * model.materials[0].wave_modulus_pa) < 1e-4


def relative_l2(ours, theirs, floor=0.0):
    """Norm of the difference over the norm of theirs, or over the floor where theirs is 0."""
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    assert ours.shape == theirs.shape
    return np.linalg.norm(ours - theirs) / max(np.linalg.norm(theirs), floor)
