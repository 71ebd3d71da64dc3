"""Write the constants in C of a library's channel that has an IMM."""

from __future__ import annotations

import numpy as np

from becalm.core.filter.channel_settings import ChannelSettings, GapLimit, packed_settings
from becalm.core.imm.modes import InteractingModels
from becalm.export.channel.text import NUMBER, DeviceInterface, of_array, of_number, of_struct
from becalm.export.naming import identifiers
from becalm.native.library import CONSTANTS, SETTINGS


def modes_door(
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
        Longest gap that the IMM is carried across.
    prefix : str
        Prefix of its names in C.
    sizes : (int, int)
        Largest numbers of states and of modes of all filters that are written together; the second is even.
    """
    bank, (n, m) = modes.bank(np.ones(1)), sizes
    settings = settings._replace(component=modes.component, noise_variance=modes.least_noise_variance, gate=None)
    numbers = {
        "modes": len(modes.modes),
        "keeps_level": int(modes.component.keeps_level),
        "rejects": int(bank.wild[1]),
        "largest_level": bank.largest[1].item(),
        "noise_variance": modes.modes[0].noise_variance,
        "V": bank.wild[0].item(),
    }
    arrays = {"F": bank.F, "Q": bank.Q, "T": bank.T, "h": bank.H, "c": bank.C}
    arrays |= {"R": bank.R, "tail": bank.tail, "start": bank.start}
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
