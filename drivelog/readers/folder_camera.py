"""The camera of a plain drive folder: a rectified one, or a raw pair with its calibration file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from polemap.drivelog.drive import FrameSource
from polemap.drivelog.errors import InputError
from polemap.drivelog.images import LARGEST_BYTES, ImagePairs, RectifiedPairs
from polemap.drivelog.readers.drive_yaml_parts import CameraPart, MountingPart, RawCameraPart
from polemap.drivelog.source_names import FOLDER, SourceNames
from polemap.parsing.errors import named
from polemap.parsing.pictures import check_size
from polemap.parsing.text import read_bytes
from polemap.stereo.calibration_trees import Stated
from polemap.stereo.errors import StereoError
from polemap.stereo.io import read_calibration
from polemap.stereo.rectify import Rectifier
from polemap.stereo.rig import Mounting, StereoRig

# what interpolation at the edges leaves out is not worth a word
_ALL = 0.995


@dataclass(frozen=True, slots=True)
class FolderCamera:
    """What drive.yaml says of the camera.

    Attributes:
        rig: of the rectified pictures.
        rectifier: None where the files hold rectified pictures.
        bits: how many of a pixel are filled, where it is stated.
        calibration: names of the files that calibrate raw pictures.
    """

    rig: StereoRig
    rectifier: Rectifier | None = None
    bits: int | None = None
    calibration: str = ""

    def note(self) -> str | None:
        """What a reader of a result must know about the pictures."""
        if self.rectifier is None:
            return None
        width, height = self.rectifier.raw_size_px
        covered = self.rectifier.covered()
        black = "" if covered > _ALL else f"; {100 * (1 - covered):.0f} % of them stay black"
        return (
            f"the pictures ({width}x{height} px) are rectified as they are read, with "
            f"{self.calibration}{black}"
        )

    def names(self) -> SourceNames:
        """The streams of the folder, with the camera's numbers where they are stated."""
        if self.rectifier is None:
            return FOLDER
        file = self.calibration
        told = replace(
            FOLDER.calibration,
            focal=f"the focal length of {file}",
            centre_x=f"the principal point's column of {file}",
            centre_y=f"the principal point's row of {file}",
            baseline=f"the baseline of {file}",
        )
        return replace(FOLDER, calibration=told)

    def pairs(self, paths: tuple[tuple[Path, Path], ...]) -> FrameSource:
        """The rectified pictures of these files.

        Raises:
            InputError: a file is missing.
        """
        if self.rectifier is None:
            images = ImagePairs(paths, (self.rig.width_px, self.rig.height_px), self.bits)
            images.check_exist()
            return images
        images = ImagePairs(paths, self.rectifier.raw_size_px, self.bits)
        images.check_exist()
        if paths:
            self._check_size(paths[0][0])
        return RectifiedPairs(images, self.rectifier)

    def _check_size(self, path: Path) -> None:
        """The first picture already tells whether the calibration is for another size."""
        with named(path, InputError, "image"):
            size = check_size(read_bytes(path, LARGEST_BYTES))
        wanted = self.rectifier.raw_size_px if self.rectifier else size
        if size != wanted:
            raise InputError(
                f"{path}: {size[0]}x{size[1]} pixels, but {self.calibration} is for "
                f"{wanted[0]}x{wanted[1]}: calibrate for these pictures, or scale the calibration"
            )


def read_camera(
    folder: Path, camera: CameraPart | RawCameraPart, allow_links: bool = False
) -> FolderCamera:
    """The camera that drive.yaml describes, its calibration file read.

    Raises:
        InputError: the calibration cannot be read or used, or leads out of the folder.
    """
    mount = _mounting(camera.vehicle_from_camera)
    if isinstance(camera, CameraPart):
        rig = StereoRig(
            width_px=camera.width_px,
            height_px=camera.height_px,
            focal_px=camera.focal_px,
            cx_px=camera.cx_px,
            cy_px=camera.cy_px,
            baseline_m=camera.baseline_m,
            vehicle_from_camera=mount,
        )
        return FolderCamera(rig, bits=camera.bits)
    place = folder / "drive.yaml"
    names = [camera.calibration] if isinstance(camera.calibration, str) else camera.calibration
    paths = [folder / name for name in names]
    for name, path in zip(names, paths, strict=True):
        if not allow_links and not path.resolve().is_relative_to(folder.resolve()):
            raise InputError(
                f"{place}: camera.calibration: '{name}' leads out of the drive folder; put it "
                "inside, or write `allow_links: true`"
            )
    size = None
    if camera.width_px is not None and camera.height_px is not None:
        size = (camera.width_px, camera.height_px)
    stated = Stated(camera.cameras, camera.distortion_model, camera.baseline_m, size)
    try:
        rectifier = Rectifier(read_calibration(paths, stated), mount)
    except StereoError as error:
        raise InputError(str(error)) from error
    return FolderCamera(rectifier.rig, rectifier, camera.bits, " and ".join(names))


def _mounting(part: MountingPart) -> Mounting:
    return Mounting(part.x_m, part.y_m, part.z_m, part.roll_rad, part.pitch_rad, part.yaw_rad)
