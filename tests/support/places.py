"""Where the checkout, its tests and the published example are."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
PUBLISHED = ROOT.parent / "shared" / "reference" / "wideband-example1"
MEASURED_SPECTRA = PUBLISHED.with_name("rfid-200")
MEASURED_FLAT = ROOT.parent / "shared" / "reference" / "ble-flat"
MEASURED_RESPONSES = ROOT.parent / "shared" / "reference" / "uwb-flat"
