"""Checks samples of odometry and selects the publisher to follow."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.geometry import wrap_angle
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import OdometryParams
from robotctl.kernel.state import Health, OdometrySources, SecondOdometry, State
from robotctl.kernel.types import Odometry, OdometrySourceFound, OdomReceived, Phase, changed

MAX_NAMED_SOURCES = 16
"""The number of publishers whose names and frames are kept."""


def with_odometry(state: State, event: OdomReceived, params: OdometryParams) -> State:
    """Return the state after a sample; an unused sample counts as dropped."""
    odometry, health, moving = event.odometry, state.health, state.mode is Mode.MOVING
    sources = health.odometry_sources
    if event.source != sources.followed:
        if moving or not may_follow(health, event, params):
            return replace(state, health=replace(health, odometry_sources=dropped(health, event)))
        sources = replace(sources, followed=event.source, second=None)
    fault = odometry_fault(health, odometry, params)
    drive, error_m, last = state.drive, health.path_error_m, health.odometry
    if drive is not None and last is not None and not fault:
        drive = drive.measured(odometry.pose, last.pose.distance(odometry.pose))
        # While the robot ramps down, the reference stands still: its distance is no error.
        error_m = drive.score.error_m if state.phase is Phase.DRIVING else 0.0
    unusable = fault and (moving or not is_finite(odometry))
    if unusable:
        sources = replace(sources, dropped=sources.dropped + 1)
    is_news = not fault and not is_repeated(health, odometry)
    health = changed(
        health,
        odometry=last if unusable else odometry,
        odometry_t_ns=event.t_ns if is_news else health.odometry_t_ns,
        odometry_stamp_ns=odometry.stamp_ns,
        odometry_fault=fault,
        path_error_m=error_m,
        odometry_sources=sources,
    )
    return changed(state, health=health, drive=drive)


def odometry_fault(health: Health, odometry: Odometry, params: OdometryParams) -> str:
    """Return why this sample is impossible, "" if it is possible."""
    last = health.odometry
    if not is_finite(odometry):
        if isfinite(odometry.pose.theta):
            return "odometry is not finite"
        return "odometry has no valid orientation (its quaternion must have length 1)"
    if last is None:
        return ""
    # The stamp before may be of an impossible sample: a clock set back makes only one impossible.
    if odometry.stamp_ns < health.odometry_stamp_ns:
        return "odometry went back in time"
    jump_m = last.pose.distance(odometry.pose)
    if jump_m > params.max_jump_m:
        return f"odometry jumped by {jump_m:.2f} m"
    turned_rad = abs(wrap_angle(odometry.pose.theta - last.pose.theta))
    if not turned_rad <= params.max_jump_rad:  # also true for NaN, from two huge angles
        return f"odometry jumped by {turned_rad:.2f} rad"
    return ""


def is_repeated(health: Health, odometry: Odometry) -> bool:
    """Return whether a sample with a stamp repeats the last usable sample."""
    return odometry.stamp_ns != 0 and odometry == health.odometry


def is_finite(odometry: Odometry) -> bool:
    """Return whether every number of the sample is finite."""
    pose, velocity = odometry.pose, odometry.velocity
    return (
        isfinite(pose.x)
        and isfinite(pose.y)
        and isfinite(pose.theta)
        and isfinite(velocity.linear)
        and isfinite(velocity.angular)
    )


def source_found(sources: OdometrySources, event: OdometrySourceFound) -> OdometrySources:
    """Return `sources` with the name and the frame that `event` gives for a publisher."""
    others = tuple(named for named in sources.names if named[0] != event.source)
    names = (*others, (event.source, event.name))[-MAX_NAMED_SOURCES:]
    if not event.frame_id:
        return replace(sources, names=names)
    others = tuple(known for known in sources.frames if known[0] != event.source)
    frames = (*others, (event.source, event.frame_id))[-MAX_NAMED_SOURCES:]
    return replace(sources, names=names, frames=frames)


def may_follow(health: Health, event: OdomReceived, params: OdometryParams) -> bool:
    """Return whether the odometry of this publisher may be used from now on, if not MOVING."""
    age_s = abs(event.t_ns - health.odometry_t_ns) / NS_PER_S
    return health.odometry is None or age_s > params.timeout_s


def dropped(health: Health, event: OdomReceived) -> OdometrySources:
    """Return the sources with one more dropped sample, from a publisher that is not followed."""
    last, pose = health.odometry, event.odometry.pose
    distance_m = angle_rad = 0.0
    if last is not None:
        distance_m = last.pose.distance(pose)
        angle_rad = abs(wrap_angle(pose.theta - last.pose.theta))
    sources = health.odometry_sources
    second = SecondOdometry(event.source, event.t_ns, distance_m, angle_rad)
    return replace(sources, dropped=sources.dropped + 1, second=second)
