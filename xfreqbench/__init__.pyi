import typing

from . import errors as errors
from .data.collection import Collection as Collection
from .data.collection import open_collection as open_collection
from .data.dataset import PasDataset as PasDataset
from .data.dataset import open_dataset as open_dataset
from .data.generate import generate as generate
from .data.power import power_db as power_db
from .data.power import received_power_dbm as received_power_dbm
from .data.rooms import generate_rooms as generate_rooms
from .data.shipped import fetch as fetch
from .data.shipped import load as load
from .data.splits import Split as Split
from .data.splits import make_splits as make_splits
from .data.splits import protocols as protocols
from .data.statistics import statistics as statistics
from .data.views import plot as plot
from .data.views import to_xarray as to_xarray
from .data.writer import PasWriter as PasWriter
from .data.writer import SampleBlock as SampleBlock
from .maps import metrics as metrics
from .maps.bartlett import BartlettBeam as BartlettBeam
from .maps.grid import AngularGrid as AngularGrid
from .methods.check import check_method as check_method
from .methods.contract import Budget as Budget
from .methods.contract import Method as Method
from .methods.contract import Progress as Progress
from .methods.contract import RoomMethod as RoomMethod
from .methods.learning.encoding import Scaling as Scaling
from .methods.learning.encoding import positional_encoding as positional_encoding
from .methods.learning.samples import to_torch as to_torch
from .methods.learning.targets import Beams as Beams
from .methods.learning.targets import GridView as GridView
from .methods.learning.training import ChannelField as ChannelField
from .methods.learning.training import LearnedMethod as LearnedMethod
from .methods.learning.training import TrainingConfig as TrainingConfig
from .methods.rooms import PerRoom as PerRoom
from .report.leaderboard.tables import leaderboard as leaderboard
from .runs.folder import load_method as load_method
from .runs.folder import load_predictions as load_predictions
from .runs.folder import read_records as read_records
from .runs.records import RunRecord as RunRecord
from .runs.run import run as run
from .runs.scoring import score as score
from .runs.training_log import training_log as training_log
from .scene.drawn_rooms import draw_room as draw_room
from .scene.families import load_family as load_family
from .scene.materials import permittivity as permittivity
from .scene.model import ReceiverArray as ReceiverArray
from .scene.model import Scene as Scene
from .scene.model import Surface as Surface
from .scene.model import TransmitterGrid as TransmitterGrid
from .scene.model import load_scene as load_scene
from .scene.model import parse_scene as parse_scene
from .system.version import __version__ as __version__
from .tracing.solvers import make_tracer as make_tracer
from .tracing.tracer import TraceSettings as TraceSettings

if not typing.TYPE_CHECKING:  # lazy_loader reads this too: these packages give their names when they are called
    from . import methods as methods
    from . import scenes as scenes

def methods() -> list[str]: ...
def scenes() -> list[str]: ...
