"""Watchdog time and minimum baud rate for a given control period (docs/reference/wire.md)."""

from drftjax.common.errors import InputError
from hils.link.messages import BITS_PER_BYTE, Drive, Measurement, wire_bytes

# Where none is given [bit/s]: it carries ticks of 1 ms, and every usual USB adapter has it.
USUAL_BAUD = 921_600


LEAST_WATCHDOG_US = 20_000


WATCHDOG_TICKS = 5


# The watchdog's field on the wire holds 65.5 s.
LONGEST_TICK = 13.0


def watchdog_us(tick_us: int) -> int:
    """Time without a command after which a rig goes SAFE [us], for a control period [us]."""
    return max(LEAST_WATCHDOG_US, WATCHDOG_TICKS * tick_us)


def watchdog_ms(tick_us: int) -> int:
    """The same in whole milliseconds, rounded up."""
    return -(-watchdog_us(tick_us) // 1000)


def require_baud(baud: int, tick: float) -> None:
    """Refuse a control period [s] in which the line cannot carry a measurement and a command.

    The two directions do not share the line, so the longer of both frames decides.

    Raises:
        InputError: the line is too slow, or either number cannot be.
    """
    if not 1e-6 <= tick <= LONGEST_TICK:
        raise InputError(f"tick is {tick:.4g} s, must lie between 1e-06 and {LONGEST_TICK:g} s")
    if baud < 1:
        raise InputError(f"baud rate is {baud}, must be at least 1")
    meas, command = wire_bytes(Measurement), wire_bytes(Drive)
    bits = max(meas, command) * BITS_PER_BYTE
    if bits > baud * tick:
        raise InputError(
            f"a tick of {tick * 1e3:.4g} ms is too short for {baud} baud: a MEAS of {meas} bytes "
            f"(a CMD has {command}) at {BITS_PER_BYTE} bits a byte takes {bits} / {baud} = "
            f"{bits / baud * 1e3:.4g} ms; give a tick of at least that, or at least "
            f"{bits / tick:.0f} baud"
        )
