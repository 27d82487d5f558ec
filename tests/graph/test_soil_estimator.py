# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The soil estimator node: its outputs, its fault reports, and its robustness."""

import math
import signal
from dataclasses import replace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from trackslip_msgs.msg import MachineState, TrackHydraulics

from trackslip_common.make import set_stamp, stamp_ns_of
from trackslip_estimation.nodes.soil_estimator import soil_health
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil import records
from trackslip_estimation.soil.pressure_watch import PressureFault
from trackslip_estimation.soil.records import Hydraulics, PoseWithCovariance
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_sim.machine.hydraulics import InputErrors, soil_inputs
from trackslip_sim.scenarios.scenario import Scenario, Segment
from trackslip_sim.truth.simulate import simulate

INPUTS = ("machine_state", "hydraulics")
_BURST = 20  # inputs per burst; the kernel queues about 100 for a process that is not scheduled
PRESSURES = ("left_pressure", "right_pressure", "left_spool", "right_spool")


def message_of(soil_input):
    """The message that carries an input."""
    if isinstance(soil_input, Hydraulics):
        message = TrackHydraulics(**{name: getattr(soil_input, name) for name in PRESSURES})
    else:
        message = MachineState(motion_state=int(soil_input.motion))
        message.v_x, message.v_y, message.yaw_rate = map(float, soil_input.twist)
        message.twist_covariance = soil_input.twist_covariance.ravel()
        message.x, message.y, message.heading = map(float, soil_input.pose.mean)
        message.pose_covariance = soil_input.pose.covariance.ravel()
        message.left_slip, message.right_slip, message.slip_angle = map(float, soil_input.slips)
        message.attitude_covariance = np.diag((*soil_input.tilt_variance, 0.0)).ravel()
        message.swing = soil_input.swing
        is_known = np.isfinite(soil_input.swing_variance)
        message.swing_covariance = np.full(4, soil_input.swing_variance if is_known else -1.0)
    set_stamp(message, soil_input.stamp_ns)
    return message


class SoilNode:
    """The node, driven by the test."""

    def __init__(self, programs, observer, **parameters):
        self._observer = observer
        self._topics = {topic: observer.publisher(topic) for topic in INPUTS}
        self.forces, self.soils = observer.subscribe("track_forces"), observer.subscribe("soil")
        self.healths = observer.healths()
        self.program = programs.node("soil_estimator", **parameters)
        for topic in (*INPUTS, "track_forces", "soil"):
            observer.wait_for_ends(topic, "soil_estimator")
        observer.wait_until_active("soil_estimator")

    def send(self, inputs):
        """Publish the inputs without waiting for outputs."""
        for soil_input in inputs:
            self._topics[soil_input.source].publish(message_of(soil_input))

    def feed(self, inputs, estimator):
        """Publish in bursts and wait for each; outputs of ``estimator`` for the same inputs, by stamp."""
        outputs = {}
        for k in range(0, len(inputs), _BURST):
            burst = inputs[k : k + _BURST]
            self.send(burst)
            forces = [o for one in burst for o in estimator.advance(one) if hasattr(o, "thrust")]
            outputs |= {o.stamp_ns: o for o in forces}
            expected = len(outputs)
            self._observer.wait(lambda n=expected: len(self.forces) >= n, "forces")
        return outputs

    def until_reported(self, level, *words, meanwhile=lambda: None):
        def is_reported(health):
            return health.name == "soil_estimator" and all(word in health.message for word in words)

        def is_level_reported():
            meanwhile()
            return any(is_reported(h) and h.level == level for h in self.healths)

        self._observer.wait(is_level_reported, f"{words}")


@pytest.fixture
def inputs():
    segments = (Segment(2.0, 0.0, 0.0), Segment(4.0, 2.0, 2.0), Segment(4.0, 1.0, 2.2))
    truth = simulate(Scenario(name="test", soil="sand", segments=segments))
    p = load_soil_parameters()
    return list(soil_inputs(truth, p.vehicle.whole(), load_slip_parameters().motion, InputErrors()))


def test_node_publishes_the_outputs_of_the_estimator_and_takes_new_limits(
    real_time, programs, observer, inputs
):
    node = SoilNode(programs, observer)
    outputs = node.feed(inputs, SoilEstimator(load_soil_parameters()))
    assert len(node.forces) == len(outputs) > 90
    for message in node.forces:
        expected = outputs[stamp_ns_of(message)]
        assert (message.left_thrust, message.right_thrust) == expected.thrust
        assert (message.left_resistance, message.right_resistance) == expected.resistance
    assert node.soils[-1].mu_r == pytest.approx(0.2, rel=0.05)
    assert node.soils[-1].header.frame_id == "base_link"
    assert sum(node.soils[-1].class_probabilities) == pytest.approx(1.0)
    node.until_reported(DiagnosticStatus.OK, "running")
    for name, value, accepted in (
        ("stuck_time", 2.0, True),
        ("high_slip", 2.0, False),
        ("vehicle.mass.mass", 1.0, False),
    ):
        (result,) = observer.set_parameters("soil_estimator", **{name: value})
        assert result.successful is accepted, name


@pytest.mark.parametrize("fault", PressureFault)
def test_each_fault_of_the_pressures_has_a_remedy(fault, monkeypatch):
    monkeypatch.setattr(SoilEstimator, "faults", (fault,))
    health = soil_health(SoilEstimator(load_soil_parameters()), 0.0, {})
    assert health.message.startswith(f"{fault.value}: the estimates are held; ")
    assert health.message.rpartition("; ")[2].split()[0] in ("check", "exchange")


@pytest.mark.parametrize(
    ("stride", "changes", "words"),
    [
        (1, {"left_pressure": math.nan}, "hydraulics rejected (contains nan or infinity)"),
        (25, {}, "hydraulics at other stamps than machine_state"),
    ],
)
def test_hydraulics_that_arrive_but_are_not_used_are_not_called_silent(
    programs, observer, inputs, stride, changes, words
):
    node = SoilNode(programs, observer)
    states = [i for i in inputs if not isinstance(i, Hydraulics)]
    unusable = [replace(i, **changes) for i in inputs if isinstance(i, Hydraulics)][::stride]
    mixed = sorted([*states, *unusable], key=lambda i: i.stamp_ns)
    node.feed(mixed[:1200], SoilEstimator(load_soil_parameters()))
    node.until_reported(DiagnosticStatus.ERROR, words, "held")


def test_rejected_machine_states_are_reported(programs, observer, inputs):
    """They left the node running without an output."""
    node = SoilNode(programs, observer)
    states = (replace(i, twist=np.full(3, math.nan)) for i in inputs if not isinstance(i, Hydraulics))
    node.until_reported(
        DiagnosticStatus.ERROR,
        "machine_state rejected (contains nan or infinity)",
        meanwhile=lambda: node.send([next(states)]),
    )


@pytest.mark.slow
def test_faults_are_named_and_invalid_input_does_not_end_the_node(programs, observer, inputs):
    node = SoilNode(programs, observer)
    node.until_reported(DiagnosticStatus.WARN, "waiting for machine_state")
    nan = float("nan")
    bad = [
        Hydraulics(1, nan, nan, nan, nan),
        records.MachineState(
            *(1, np.full(3, nan), np.full((3, 3), -1.0), PoseWithCovariance(np.full(3, nan), np.eye(3))),
            *(np.full(3, nan), Motion.UNKNOWN),
        ),
        records.MachineState(
            *(10**15, np.zeros(3), np.zeros((3, 3)), PoseWithCovariance(np.zeros(3), np.eye(3))),
            *(np.zeros(3), Motion.UNKNOWN),
        ),
    ]
    without = [i for i in inputs if not isinstance(i, Hydraulics)]
    estimator = SoilEstimator(load_soil_parameters())
    node.feed(without[:300], estimator)
    node.send(bad)
    node.feed(without[300:], estimator)
    node.until_reported(DiagnosticStatus.ERROR, "hydraulics silent", "held")
    node.until_reported(DiagnosticStatus.ERROR, "slip estimator silent")
    code, _ = node.program.end(signal.SIGINT)
    assert code == 0
    assert node.program.stderr.count("Traceback") == 0
