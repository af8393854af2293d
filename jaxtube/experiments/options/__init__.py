"""The options of each command, from which the parser is built; each option holds the rule of its
values."""

from jaxtube.experiments.options.common import PROGRAM, Options, command_line, flag, title
from jaxtube.experiments.options.designs import (
    BeyondOptions,
    CoverageOptions,
    DesignOptions,
    ExportOptions,
    FalsifyOptions,
    GuaranteeOptions,
    MontecarloOptions,
    PaperOptions,
)
from jaxtube.experiments.options.robots import (
    IdentifyOptions,
    LogOptions,
    PathOptions,
    ReplayOptions,
)
from jaxtube.experiments.options.searches import FitOptions, MapsOptions, TuneOptions
from jaxtube.experiments.options.tools import (
    AnimateOptions,
    BenchOptions,
    CheckOptions,
    CompletionOptions,
    DoctorOptions,
    FiguresOptions,
    ListOptions,
)

__all__ = [
    "COMMANDS",
    "DEFAULT_COMMAND",
    "PROGRAM",
    "AnimateOptions",
    "BenchOptions",
    "BeyondOptions",
    "CheckOptions",
    "CompletionOptions",
    "CoverageOptions",
    "DesignOptions",
    "DoctorOptions",
    "ExportOptions",
    "FalsifyOptions",
    "FiguresOptions",
    "FitOptions",
    "GuaranteeOptions",
    "IdentifyOptions",
    "ListOptions",
    "LogOptions",
    "MapsOptions",
    "MontecarloOptions",
    "Options",
    "PaperOptions",
    "PathOptions",
    "ReplayOptions",
    "TuneOptions",
    "command_line",
    "flag",
    "title",
]

DEFAULT_COMMAND = "paper"

COMMANDS: dict[str, type[Options]] = {
    kind.command: kind
    for kind in (
        PaperOptions,
        DesignOptions,
        MontecarloOptions,
        FalsifyOptions,
        GuaranteeOptions,
        FitOptions,
        MapsOptions,
        CoverageOptions,
        BeyondOptions,
        PathOptions,
        TuneOptions,
        IdentifyOptions,
        ReplayOptions,
        ExportOptions,
        BenchOptions,
        AnimateOptions,
        FiguresOptions,
        ListOptions,
        CheckOptions,
        DoctorOptions,
        CompletionOptions,
    )
}
