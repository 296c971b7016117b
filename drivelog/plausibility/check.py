"""The whole of the plausibility check of a drive, theme by theme."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding, worst_first
from polemap.drivelog.plausibility import (
    absolute,
    accuracy,
    antenna,
    breaks,
    detector_place,
    fix_delay,
    lines,
    motion,
    places,
    poles,
    reference,
    resolution,
    rows,
    steering,
    stretches,
    time,
)
from polemap.drivelog.plausibility.jitter import without_jitter
from polemap.drivelog.plausibility.odometer import (
    Odometer,
    of_gnss,
    of_odometry,
    of_places,
    of_reference,
)
from polemap.vehicle.pose import rotate

# an offset beyond this may be a round of a drive in laps
_ROUND_S, _CLEARLY_NEARER = 5.0, 2.0
_BY_VALUE = ("pole_scale", "pole_turn_scale", "pole_mounting")
# over less than this the places of fixes do not tell one clock from another
_PLACES_TELL_S = 1.0


def check_drive(drive: Drive) -> list[Finding]:
    """What in a drive cannot be right, errors first.

    Streams are held against each other: what they agree on is believed, and where two of three
    agree the third is named. With nothing to compare with, limits of what cars and cameras do
    remain. Nothing is read but what `drive` holds; `pictures` looks at the images.
    """
    found = list(drive.findings)
    found += time.rate_findings(drive) + time.overlap_findings(drive)
    found += breaks.coverage_findings(drive, time.stamps_of(drive))
    found += time.gap_findings(drive) + rows.row_findings(drive)
    found += resolution.resolution_findings(drive)
    found += breaks.sparse_findings(drive)
    if not any(f.kind == "reference_held" for f in found):
        found += breaks.jump_findings(drive)
    found += absolute.duplicate_findings(drive) + absolute.vehicle_findings(drive)
    found += steering.wheelbase_findings(drive)
    found += absolute.camera_findings(drive)
    found += absolute.gnss_findings(drive) + absolute.pole_findings(drive)
    found += lines.line_findings(drive)
    of_places = places.zone_findings(drive) + places.distance_findings(drive)
    found += of_places or breaks.drift_findings(drive)
    found += _motion(drive)
    return _once(worst_first(found))


def _motion(drive: Drive) -> list[Finding]:
    """Odometry, reference, fixes and poles as four tellers of one motion."""
    names = drive.names
    odometry = gnss = yawed = None
    if drive.odometry is not None:
        odometry = _moving(of_odometry(drive.odometry, names.odometry))
    if drive.gnss is not None:
        gnss = _moving(of_gnss(drive.gnss, names.gnss))
    posed = drive.reference is not None and len(drive.reference) > 5
    if posed and drive.reference is not None:
        yawed = of_reference(without_jitter(drive.reference), names.reference)
    found = reference.range_findings(drive)
    turn_ratio = float("nan")
    if odometry is not None and yawed is not None:
        turn_ratio = motion.find_scales(odometry, yawed).turn
    trusted = yawed
    if posed and drive.reference is not None:
        chords = reference.find_chords(drive.reference)
        if chords is not None:
            yaw_found = reference.yaw_findings(drive, chords, turn_ratio)
            found += yaw_found or reference.lever_findings(drive, chords)
            if yaw_found:
                # the yaw is wrong: the positions alone still tell way and turn
                stamps, points = drive.reference.stamp_s, drive.reference.poses[:, :2]
                trusted = of_places(names.reference, stamps, points, 1.0)
            if any(f.kind == "reference_axes" for f in yaw_found + found):
                trusted = yawed
    trusted = _moving(trusted)
    posed_well = trusted is yawed and trusted is not None
    frozen = stretches.frozen_speed(drive, trusted if trusted is not None else gnss)
    if frozen:
        return found + frozen
    stuck, moving = stretches.frozen_fixes(drive, trusted if posed_well else odometry)
    found += stuck
    if stuck and moving is not None:
        # what repeats is neither way nor turn
        gnss = _moving(of_gnss(moving, names.gnss))
    offset = time.find_offset(odometry, trusted, gnss, lambda a, b: poles.contradicted(drive, a, b))
    if offset is not None and not _places_contradict(drive, offset):
        found.append(offset.finding())
    else:
        offset = None
    odometry, trusted, gnss = (time.shifted(track, offset) for track in (odometry, trusted, gnss))
    if posed_well and odometry is not None and trusted is not None and not found:
        found += reference.across_findings(odometry, trusted)
    of_scales = _scales(drive, odometry, trusted, gnss)
    mirrored = any(f.kind == "reference_axes" for f in of_scales)
    found += of_scales
    if not any(f.stream == names.odometry and f.severity == "error" for f in found):
        found += absolute.odometry_findings(drive)
    teller = trusted if posed_well and not mirrored else odometry
    if teller is None:
        return found
    quiet = not any(f.stream in (names.odometry, names.reference) for f in found)
    if quiet and offset is None:
        late = fix_delay.delay_findings(drive, teller, heading_known=posed_well)
        found += late or antenna.antenna_findings(drive, teller, heading_known=posed_well)
        found += accuracy.fix_findings(drive, teller, is_reference=posed_well)
        if posed_well and odometry is not None:
            found += accuracy.pose_findings(drive, odometry)
    agreed = odometry is not None and (trusted is not None or gnss is not None)
    of_poles = poles.repeated_findings(drive, teller)
    of_poles = of_poles or poles.motion_findings(drive, teller, confirmed=agreed)
    if of_poles and of_poles[0].kind in _BY_VALUE:
        # the fit of all these at once tells their values
        fitted = detector_place.place_findings(drive, teller, surveyed=posed_well) if quiet else []
        kind = of_poles[0].kind
        if kind == "pole_mounting":
            of_poles = fitted
        elif scaled := [f for f in fitted if f.kind != "pole_mounting"]:
            of_poles = scaled
    if quiet and not of_poles:
        of_poles = detector_place.place_findings(drive, teller, surveyed=posed_well)
        of_poles = of_poles or accuracy.variance_findings(drive, teller)
    return found + of_poles


def _places_contradict(drive: Drive, offset: time.Offset) -> bool:
    """Whether fixes and reference, one of which fits another time, lie nearer as they are.

    On laps, a round earlier fits the motion as well.
    """
    gnss, posed = drive.gnss, drive.reference
    if abs(offset.late_s) < _PLACES_TELL_S:
        return False
    late_s = {drive.names.gnss: -offset.late_s, drive.names.reference: offset.late_s}.get(
        offset.late.name
    )
    if gnss is None or posed is None or late_s is None:
        return False
    fixes = np.stack([gnss.east_m, gnss.north_m], axis=1)
    told, moved = (
        np.hypot(*(fixes - poses[:, :2] - rotate(drive.gnss_antenna_m, poses[:, 2])).T)
        for poses in (
            posed.at(stamps, max_gap_s=5.0) for stamps in (gnss.stamp_s, gnss.stamp_s + late_s)
        )
    )
    both = np.isfinite(told) & np.isfinite(moved)
    if both.sum() <= 5:
        return False
    # a clock that is seconds off shows in the places by more than a bend that another round has
    ratio = _CLEARLY_NEARER if abs(offset.late_s) > _ROUND_S else 1.0
    return bool(np.median(told[both]) < ratio * np.median(moved[both]))


def _scales(
    drive: Drive,
    odometry: Odometer | None,
    trusted: Odometer | None,
    gnss: Odometer | None,
) -> list[Finding]:
    """Scales of speed and turn; fixes tell whether odometry or reference is off."""
    found = []
    names = drive.names
    if odometry is None:
        if trusted is not None and gnss is not None:
            scales = motion.find_scales(trusted, gnss)
            found += motion.speed_findings(names.reference, scales, names.gnss, noisy=True)
        return found
    judge = trusted if trusted is not None else gnss
    if judge is None:
        return []
    noisy = judge is gnss or judge.smooth_s > 1.0
    level, of_offset = (odometry, []) if noisy else stretches.yaw_rate_offset(odometry, judge)
    scales = motion.find_scales(odometry, judge)
    if of_offset and not motion.turn_findings(
        "", leveled := motion.find_scales(level, judge), "", noisy=False
    ):
        # an offset alone explains the turns
        found += of_offset
        scales = replace(scales, turn=leveled.turn)
    if noisy:
        # fixes turn by their noise: the bends are chosen by the odometry
        turns = motion.find_scales(judge, odometry).turn
        turn = 1.0 / turns if turns else float("nan")
        scales = motion.Scales(scales.speed, turn, scales.speed_spans, scales.turn_spans)
    alike = bool(scales.speed > 30.0 and abs(scales.turn / scales.speed - 1.0) < 0.2)
    stream, against = names.odometry, judge.name
    if gnss is not None and judge is not gnss and np.isfinite(scales.speed):
        other = motion.find_scales(odometry, gnss)
        ratio = abs(scales.speed)
        off = ratio > 0.0 and abs(np.log(ratio)) > 0.3
        if off and np.isfinite(other.speed) and 0.7 < other.speed < 1.4:
            stream, against = names.reference, f"{names.odometry} and {names.gnss}"
            inverse = motion.Scales(1.0 / scales.speed, scales.turn, scales.speed_spans, 0)
            return motion.speed_findings(stream, inverse, against, noisy=False)
    found += motion.speed_findings(stream, scales, against, noisy=noisy, turn_alike=alike)
    if not alike:
        of_turns = motion.turn_findings(stream, scales, against, noisy=noisy)
        signs = any(f.kind == "yaw_rate_sign" for f in of_turns)
        if signs and judge is trusted and poles.contradicted(drive, judge, odometry) is judge:
            return [*found, reference.mirrored_finding(names, scales.turn)]
        found += of_turns
    if not found:
        found += stretches.disagreeing_stretches(odometry, judge, gnss)
    if not found and not noisy:
        found += stretches.disagreeing_turns(
            odometry, judge, lambda mine, theirs: poles.contradicted(drive, theirs, mine)
        )
    return found


def _moving(track: Odometer | None) -> Odometer | None:
    """The track if it holds enough to say anything."""
    return track if track is not None and len(track) >= 4 else None


def _once(findings: list[Finding]) -> list[Finding]:
    """One finding a kind and stream, the worst; the same note of several streams is one note."""
    kept: dict[tuple[str, str], Finding] = {}
    for finding in findings:
        note = finding.severity == "note"
        key = (finding.kind, "note" if note else finding.stream)
        first = kept.get(key)
        if first is None:
            kept[key] = finding
        elif note and finding.stream not in first.stream:
            kept[key] = replace(first, stream=f"{first.stream}, {finding.stream}")
    return list(kept.values())
