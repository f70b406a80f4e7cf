"""Where the checkout, its tests and the published example are."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
PUBLISHED = ROOT.parent / "shared" / "reference" / "wideband-example1"
MEASURED_SPECTRA = PUBLISHED.with_name("rfid-200")
MEASURED_FLAT = ROOT.parent / "shared" / "reference" / "ble-flat"
MEASURED_RESPONSES = ROOT.parent / "shared" / "reference" / "uwb-flat"


def fingerprint_path(scene_name: str, *, diffraction: bool = True) -> Path:
    """The file with the fingerprint of a shipped scene, as `generate` traces it, or without diffraction."""
    return ROOT / "scenes" / f"{scene_name}{'' if diffraction else '_without_diffraction'}_fingerprint.npz"
