"""Readers of palletising files: StackBuilder XML, NIST pack lists and Pally JSON become placed packages."""

from config.readers.pattern import (
    PatternFile,
    PatternFormat,
    PatternPallet,
    choose_pallet,
    read_pattern,
    vary_layers,
)

__all__ = ["PatternFile", "PatternFormat", "PatternPallet", "choose_pallet", "read_pattern", "vary_layers"]
