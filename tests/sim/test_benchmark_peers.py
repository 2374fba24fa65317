"""Other engines in the benchmark: what they are given, how their motion is read, and what is said where they cannot.

The engines themselves are an extra of the package; here stand-ins take their place, whose rods take the shape of their
rest curvature at once.
"""

from __future__ import annotations

import dataclasses
import math
import re
import sys
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

from sim.benchmark import measure
from sim.benchmark.bullet_engine import BulletEngine, SegmentSetting
from sim.benchmark.case import cantilever, fault_and_recovery, rolling, rolling_limit, vibration
from sim.benchmark.elastica_rod import ElasticaRod, ElementSetting
from sim.benchmark.measurement import simulate_summary
from sim.benchmark.mujoco_chain import ChainSetting, MujocoChain, model_xml
from sim.benchmark.play import Unable

PEERS = [(MujocoChain(), "mujoco"), (ElasticaRod(), "elastica")]


@pytest.mark.parametrize(("engine", "module"), PEERS)
def test_a_peer_that_is_not_installed_is_reported_for_every_case(engine, module, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    rows = list(measure([cantilever(), vibration()], [engine]))
    assert [row.case for row in rows] == ["cantilever", "vibration"]
    for row in rows:
        assert row.reason.startswith("not installed")
        assert "softbot[bench]" in row.reason
        assert row.value is None


@pytest.mark.parametrize(("engine", "module"), PEERS)
def test_peers_say_that_they_have_no_pneumatics(engine, module):
    with pytest.raises(Unable, match="no pneumatics, no sequencer"):
        engine.settings(fault_and_recovery())
    for case in (rolling(), rolling_limit(), cantilever(), vibration()):
        assert len(engine.settings(case)) > 0


def test_the_segment_twin_says_that_it_has_no_clamp():
    with pytest.raises(Unable, match="no clamp"):
        BulletEngine().settings(cantilever())


def test_the_segment_twin_vibrates():
    case = vibration()
    setting = SegmentSetting(6, 0.005)
    measured = BulletEngine().measure(case, setting, simulate_summary)
    assert abs(case.error_percent(measured.value, case.ruler(simulate_summary).value)) < 8.0
    assert measured.wall_s > 0.0


# --- MuJoCo -------------------------------------------------------------


def test_the_chain_is_the_rod():
    case = rolling()
    root = ElementTree.fromstring(model_xml(case, ChainSetting(8, 0.005, cone="pyramidal")))
    masses = [float(each.attrib["mass"]) for each in root.iter("inertial")]
    assert len(masses) == 8
    assert sum(masses) == pytest.approx(case.body.mass_kg)
    joints = list(root.iter("joint"))
    assert len(joints) == 2 * 7
    stiffness = case.body.bending_stiffness_N_m2 * 8 / case.body.length_m
    for joint in joints:
        assert float(joint.attrib["stiffness"]) == pytest.approx(stiffness)
        assert float(joint.attrib["damping"]) == pytest.approx(stiffness * case.body.damping_time_s)
    option = root.find("option")
    assert (option.attrib["cone"], option.attrib["timestep"]) == ("pyramidal", "0.005")
    assert [geom.attrib["friction"] for geom in root.iter("geom")] == ["0.6 0 0"] * 9  # the floor and each link


def test_a_clamped_chain_is_held_at_its_face():
    root = ElementTree.fromstring(model_xml(cantilever(), ChainSetting(8, 0.005)))
    assert root.find(".//freejoint") is None
    joints = list(root.iter("joint"))
    assert len(joints) == 2 * 8
    assert float(joints[0].attrib["stiffness"]) == pytest.approx(2.0 * float(joints[2].attrib["stiffness"]))
    assert not list(root.iter("geom"))


class Mujoco:
    """A stand-in: links lie as the rest angles of their hinges say, whatever acts on them."""

    mjtWarning = SimpleNamespace(mjWARN_BADQPOS=0, mjWARN_BADQVEL=1, mjWARN_BADQACC=2)

    def __init__(self, bad=0):
        self.bad, self.steps = bad, 0
        self.MjModel = SimpleNamespace(from_xml_string=self.model)
        self.MjData = self.data

    def model(self, xml):
        links, clamped = xml.count("<inertial"), "<freejoint" not in xml
        self.link_m = 0.15 / links
        ball = 'type="ball"' in xml
        size = (4 if ball else 2) * (links if clamped else links - 1)
        return SimpleNamespace(
            qpos_spring=np.zeros(size + (0 if clamped else 7)), links=links, clamped=clamped, ball=ball
        )

    def data(self, model):
        return SimpleNamespace(
            warning=[SimpleNamespace(number=self.bad)] * 3,
            xpos=np.zeros((model.links + 1, 3)),
            xmat=np.zeros((model.links + 1, 9)),
        )

    def mj_step(self, model, data):
        self.steps += 1

    def mj_kinematics(self, model, data):
        rotation = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        rest = model.qpos_spring[0 if model.clamped else 7 :]
        angles = [2.0 * row[1:3] for row in rest.reshape(-1, 4)] if model.ball else list(rest.reshape(-1, 2))
        end = np.array([-0.075, 0.0, 0.0])
        for link in range(model.links):
            if link > 0 or model.clamped:
                a, b = angles[link if model.clamped else link - 1]
                about_1 = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
                about_2 = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
                rotation = rotation @ about_1 @ about_2
            data.xpos[1 + link] = end + 0.5 * self.link_m * rotation[:, 2]
            data.xmat[1 + link] = rotation.ravel()
            end = end + self.link_m * rotation[:, 2]


def held_bent(curvature=(0.0, -5.0)):
    """The cantilever with this rest curvature instead of its weight: e2 is up, so −k2 bends it down."""
    return dataclasses.replace(cantilever(), rest=lambda _t_s: np.array(curvature), duration_s=0.2)


ARC_TIP = ((1.0 - math.cos(0.75)) / 0.75, math.sin(0.75) / 0.75)


@pytest.mark.parametrize("joints", ["hinges", "ball"])
def test_the_chain_is_bent_and_read_the_right_way_round(monkeypatch, joints):
    peer = Mujoco()
    monkeypatch.setitem(sys.modules, "mujoco", peer)
    engine, case = MujocoChain(), held_bent()
    engine.warm_up(case, ChainSetting(40, 0.01, joints=joints), simulate_summary)
    peer.steps = 0
    measured = engine.measure(case, ChainSetting(40, 0.01, joints=joints), simulate_summary)
    assert measured.value == pytest.approx(ARC_TIP, abs=2e-4)
    assert peer.steps == 20
    assert 0.0 < measured.wall_s < 1.0


def test_a_driven_chain_shows_the_curvature_of_its_rest(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", Mujoco())
    from sim.benchmark.mujoco_chain import _Chain

    case = dataclasses.replace(rolling(), rest=lambda _t_s: np.array([3.0, -4.0]))
    chain = _Chain(case, ChainSetting(30, 0.005))
    chain.run(0.01)
    assert chain.motion().curvature_1_m == pytest.approx([3.0, -4.0], rel=1e-3)
    chain.close()


def test_a_chain_that_started_anew_has_failed(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", Mujoco(bad=1))
    with pytest.raises(ArithmeticError, match="unstable"):
        MujocoChain().measure(held_bent(), ChainSetting(10, 0.01), simulate_summary)


def test_labels_say_what_is_unusual():
    assert ChainSetting(10, 0.005).label == "10 links, 5 ms"
    unusual = ChainSetting(10, 0.001, cone="pyramidal", joints="ball", integrator="RK4").label
    assert unusual == "10 links, 1 ms, ball joints, pyramidal cone, RK4"
    assert ElementSetting(20, 2e-4, shear=10.0).label == "20 elements, 0.2 ms, shear × 10"


# --- PyElastica ---------------------------------------------------------


class Elastica:
    """A stand-in: a rod that takes the shape of its rest curvature; what was asked of it is kept."""

    def __init__(self, broken=False):
        self.asked = {}
        self.broken = broken
        for part in ("Constraints", "Forcing", "Contact", "Damping"):
            setattr(self, part, type(part, (), {}))
        for law in (
            "OneEndFixedBC", "GravityForces", "AnalyticalLinearDamper", "LaplaceDissipationFilter",
            "RodPlaneContactWithAnisotropicFriction",
        ):  # fmt: skip
            setattr(self, law, law)
        outer = self

        class BaseSystemCollection:
            def append(self, system):
                outer.rod = system if hasattr(system, "rest_kappa") else outer.rod

            def finalize(self):
                outer.asked["finalized"] = True

            def _with(self, *_systems):
                def using(law, **values):
                    outer.asked[law] = values

                return SimpleNamespace(using=using)

            constrain = add_forcing_to = detect_contact_between = dampen = _with

        self.BaseSystemCollection = BaseSystemCollection
        self.CosseratRod = SimpleNamespace(straight_rod=self.straight_rod)
        self.Plane = lambda **values: SimpleNamespace(**values)
        self.PositionVerlet = lambda: SimpleNamespace(step=self.step)

    def straight_rod(self, elements, start, direction, normal, **values):
        self.asked["rod"] = values
        self.length_m = values["base_length"]
        return SimpleNamespace(
            rest_kappa=np.zeros((3, elements - 1)),
            shear_matrix=np.ones((3, 3, elements)),
            position_collection=start[:, None] + direction[:, None] * np.linspace(0.0, self.length_m, elements + 1),
            director_collection=np.repeat(
                np.stack([normal, np.cross(direction, normal), direction])[:, :, None], elements, axis=2
            ),
        )

    def step(self, simulator, time_s, step_s):
        rod, count = self.rod, self.rod.director_collection.shape[2]
        element_m = self.length_m / count
        for k in range(1, count):
            a, b, _ = element_m * rod.rest_kappa[:, k - 1]
            before = rod.director_collection[:, :, k - 1]
            turn = np.array([[0.0, 0.0, b], [0.0, 0.0, -a], [-b, a, 0.0]])
            left, _, right = np.linalg.svd(before.T @ (np.eye(3) + turn))
            rod.director_collection[:, :, k] = (left @ right).T
        tangents = rod.director_collection[2] * element_m
        rod.position_collection[:, 1:] = rod.position_collection[:, :1] + np.cumsum(tangents, axis=1)
        if self.broken:
            rod.position_collection[0, -1] = np.nan
        return time_s + step_s


def test_the_cosserat_rod_is_bent_and_read_the_right_way_round(monkeypatch):
    peer = Elastica()
    monkeypatch.setitem(sys.modules, "elastica", peer)
    engine, case = ElasticaRod(), dataclasses.replace(held_bent(), duration_s=0.1)
    setting = ElementSetting(40, 0.05, shear=10.0, damping_1_s=3.0, filter_order=5)
    engine.warm_up(case, setting, simulate_summary)
    measured = engine.measure(case, setting, simulate_summary)
    assert measured.value == pytest.approx(ARC_TIP, abs=2e-3)
    assert peer.asked["GravityForces"]["acc_gravity"].tolist() == [0.0, 0.0, -9.81]
    assert peer.asked["AnalyticalLinearDamper"] == {"uniform_damping_constant": 3.0, "time_step": 0.05}
    assert peer.asked["LaplaceDissipationFilter"] == {"filter_order": 5}
    assert "OneEndFixedBC" in peer.asked
    assert peer.rod.shear_matrix[0, 0, 0] == 10.0
    bending = peer.asked["rod"]["youngs_modulus"] * math.pi * case.body.radius_m**4 / 4.0
    assert bending == pytest.approx(case.body.bending_stiffness_N_m2)


def test_its_floor_and_friction_are_those_of_the_case(monkeypatch):
    peer = Elastica()
    monkeypatch.setitem(sys.modules, "elastica", peer)
    from sim.benchmark.elastica_rod import _Elements

    case = dataclasses.replace(rolling(), rest=lambda _t_s: np.array([3.0, -4.0]))
    rod = _Elements(case, ElementSetting(20, 0.01))
    rod.run(0.01)
    assert rod.motion().curvature_1_m == pytest.approx([3.0, -4.0], rel=5e-3)
    rod.close()
    floor = peer.asked["RodPlaneContactWithAnisotropicFriction"]
    weight_N = case.body.mass_kg * case.world.gravity_m_s2 / 20
    assert weight_N / floor["k"] == pytest.approx(0.01 * case.body.radius_m)
    assert floor["kinetic_mu_array"].tolist() == [0.6, 0.6, 0.6]
    assert "OneEndFixedBC" not in peer.asked


def test_it_holds_below_a_hundredth_of_the_rolling_speed(monkeypatch):
    peer = Elastica()
    monkeypatch.setitem(sys.modules, "elastica", peer)
    from sim.benchmark.elastica_rod import _Elements

    _Elements(rolling(), ElementSetting(20, 0.01))
    holding = peer.asked["RodPlaneContactWithAnisotropicFriction"]["slip_velocity_tol"]
    assert holding == pytest.approx(0.01 * math.pi * rolling().body.radius_m, rel=1e-6)


def test_a_cosserat_rod_that_is_not_finite_has_failed(monkeypatch):
    monkeypatch.setitem(sys.modules, "elastica", Elastica(broken=True))
    with pytest.raises(ArithmeticError, match="unstable"):
        ElasticaRod().measure(held_bent(), ElementSetting(20, 0.05), simulate_summary)


def test_what_a_peer_says_of_itself_names_its_version(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", Mujoco())
    monkeypatch.setitem(sys.modules, "elastica", Elastica())
    for module in ("mujoco_chain", "elastica_rod"):
        monkeypatch.setattr(f"sim.benchmark.{module}.version", lambda name: "9.9")
    assert re.fullmatch(r"mujoco 9\.9", MujocoChain().version())
    assert re.fullmatch(r"pyelastica 9\.9", ElasticaRod().version())
