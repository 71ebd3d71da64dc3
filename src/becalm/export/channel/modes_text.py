"""Write the constants of the library's own channel with an IMM as C."""

from __future__ import annotations

import numpy as np

from becalm.core.filter.channel_settings import ChannelSettings, GapLimit, packed_settings
from becalm.core.imm.modes import InteractingModels
from becalm.export.channel.text import NUMBER, DeviceInterface, of_array, of_number, of_struct
from becalm.export.naming import identifiers
from becalm.native.library import CONSTANTS, SETTINGS


def modes_interface(
    modes: InteractingModels, settings: ChannelSettings, gap_limit: GapLimit, prefix: str, sizes: tuple[int, int]
) -> DeviceInterface:
    """Return the C interface of an IMM.

    Parameters
    ----------
    modes : InteractingModels
        The modes, in steps.
    settings : ChannelSettings
        Settings of the channel from its recipe.
    gap_limit : GapLimit
        Longest gap that the IMM predicts across.
    prefix : str
        Prefix of the channel's names in C.
    sizes : (int, int)
        Largest number of states and largest number of modes of all filters of the export; the number of modes is even.
    """
    matrices, (n, m) = modes.matrices(np.ones(1)), sizes
    settings = settings._replace(component=modes.component, noise_variance=modes.least_noise_variance, gate=None)
    numbers = {
        "modes": len(modes.modes),
        "keeps_level": int(modes.component.keeps_level),
        "rejects": int(matrices.wild[1]),
        "largest_level": matrices.largest[1].item(),
        "noise_variance": modes.modes[0].noise_variance,
        "V": matrices.wild[0].item(),
    }
    arrays = {"F": matrices.F, "Q": matrices.Q, "T": matrices.T, "h": matrices.H, "c": matrices.C}
    arrays |= {"R": matrices.R, "tail": matrices.tail, "start": matrices.start}
    fields = [
        ("settings", of_struct(packed_settings(settings, gap_limit))),
        *((name, of_number(value)) for name, value in numbers.items()),
        *((name, of_array(values)) for name, values in arrays.items()),
    ]
    mode_numbers, own = m * (1 + n + n * n), 2 * m * n * n + m * m + 2 * n + 2 * m + m * (1 + n)
    state_bytes = CONSTANTS["SENSOR_SIZE"] + CONSTANTS["IMM_HEAD_SIZE"] + NUMBER * (mode_numbers + 1)
    names = [f"{prefix}_{name}".upper() for name in identifiers([mode.name for mode in modes.modes], "mode")]
    return DeviceInterface(
        "device_modes", fields, state_bytes, SETTINGS.itemsize + NUMBER * (len(numbers) + own), names
    )
