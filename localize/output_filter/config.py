"""Settings of the output filter; what it takes to be random stands in `noise_model.py`."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class OutputConfig(BaseModel):
    """The 100 Hz pose."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rate_hz: int = Field(100, ge=1, le=1000, description="Output rate, Hz; ticks are k / rate.")
    processing_delay_s: float = Field(
        0.08,
        ge=0.0,
        le=1.0,
        description="Replay: from the arrival of a frame to its particle-filter pose, s.",
    )
    horizon_s: float = Field(1.0, gt=0.0, le=10.0, description="How late an input may be, s.")
    speed_sd_mps: float = Field(
        0.05, gt=0.0, le=10.0, description="Noise of the odometry's speed, sd, m/s."
    )
    yaw_rate_sd_radps: float = Field(
        0.003, gt=0.0, le=1.0, description="Noise of the odometry's yaw rate, sd, rad/s."
    )
    gate: bool = Field(True, description="Off: every input is taken in.")
    pose_gate: float = Field(
        0.999, gt=0.0, lt=1.0, description="Share of right poses that pass the chi-square gate."
    )
    pose_errors: Literal["shared", "independent"] = Field(
        "shared",
        description="Shared: successive poses err alike, and the output never claims to know more "
        "than the pose that it was given. Independent: each pose is a measurement of its own, as a "
        "plain EKF has it.",
    )
    pose_floor: bool = Field(
        True, description="A pose is 0.03 m and 0.003 rad (sd) less sure than it says."
    )
    offered: Literal["healthy", "all"] = Field(
        "healthy",
        description="Poses of the particle filter that are taken in: those that its health speaks "
        "for, or all (S16).",
    )
    failed_gate: Literal["recover", "ignore"] = Field(
        "recover",
        description="Poses that go on failing the gate: the output grants itself more uncertainty "
        "and goes to them at last, or ignores them until they pass (S16).",
    )
    learn_odometry: bool = Field(
        True,
        description="The scale of the speed and the offset of the yaw rate are states; off: the "
        "five states of S16.",
    )
    limit_corrections: bool = Field(
        True,
        description="Between two ticks the output is corrected by 1.5 m/s and 0.4 rad/s at most; "
        "off: by all that the filter says (S16).",
    )
    step_beyond_m: float = Field(
        1.0,
        ge=1.0,
        le=1000.0,
        description="What the output is off by beyond this is taken out at once, flagged; less, at"
        " 1.5 m/s, stated as spread while it lasts. Larger: back from unmapped streets without a"
        " step.",
    )
    reinitialize_after_s: float = Field(
        2.0,
        gt=0.0,
        le=1e9,
        description="Rejected poses before the output goes to them, s.",
    )
