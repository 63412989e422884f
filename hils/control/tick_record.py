"""Rows of a run: commands, readings and ticks."""

import math

from hils.control.limits import REST, Reading, RigCommand, Verdict
from hils.control.measurements import PolledReading
from hils.control.tick import TickOutput
from hils.events import Event, TickFlag
from hils.recording.row_stream import OnlineRow
from hils.recording.sinks import RowSink

# As plain numbers: an enumeration's own arithmetic takes a microsecond each.
FRESH, REFUSED, LATE, SKIPPED, LIMITED, RAMPING, OLD, HELD = (
    int(TickFlag[name])
    for name in ["FRESH", "REFUSED", "LATE", "SKIPPED", "LIMITED", "RAMPING", "OLD", "HELD"]
)


class TickRecord:
    """Rows of a run.

    Args:
        rows: Takes them.
        channels: Of a reading, as they stand in the run log.
        driven: True where the carriage is driven; a free one has no simulation to record.
        period: Control period [s].
    """

    def __init__(self, rows: RowSink, channels: tuple[str, ...], driven: bool, period: float):
        self._rows, self._channels = rows, channels
        self._driven, self._period = driven, period
        self._omega, self._lost = 0.0, False

    def begin(self, zeta: float) -> None:
        """Record the start of a run: the command to rest, and zeta(0) [-]."""
        self._command(0.0, REST)
        self._rows.event(0.0, Event.STARTED, zeta)

    def write(
        self,
        output: TickOutput,
        polled: PolledReading,
        seq: int,
        late: float,
        skipped: int,
        ramping: bool,
        sensor_flags: int,
        work_time: float,
        wake_delay: float,
    ) -> None:
        """Record a tick.

        Args:
            output: Of the tick.
            polled: Newest measurement.
            seq: Sequence number of the command.
            late: Time over the deadline [s].
            skipped: Ticks that passed unused before it.
            ramping: True past the profile.
            sensor_flags: Flags of the sensors' faults.
            work_time: From waking to the command being away [s].
            wake_delay: From the due time to waking [s].
        """
        rows, reading = self._rows, polled.reading
        time = output.number * self._period
        assert output.demand is not None
        if skipped:
            self._command(time, output.held)
        self._command((output.number + 1) * self._period, output.demand)
        if reading is not None:
            rows.measured(reading.time, *self._values(reading))
        if output.limited:
            rows.event(time, Event.COMMAND_LIMITED, output.asked.vx)
        if not self._driven:
            return
        refused = reading is not None and output.verdict is not Verdict.USED
        before = output.before
        rows.online(
            OnlineRow(
                time=time,
                zeta=output.after.zeta,
                x_sim=before.x,
                z_sim=before.z,
                vx_sim=before.vx,
                fx_sim=before.fx,
                fz_sim=before.fz,
                tuned=int(output.tuned),
                late=late,
                age=polled.age,
                flags=FRESH * (reading is not None)
                | REFUSED * refused
                | LATE * (late > 0)
                | SKIPPED * (skipped > 0)
                | LIMITED * output.limited
                | RAMPING * ramping
                | OLD * polled.answers_old_command
                | HELD * output.zeta_held
                | sensor_flags,
                seq_sent=seq,
                seq_received=polled.seq,
                rig_time=polled.rig_time,
                ack_seq=polled.ack_seq,
                rig_state=polled.state,
                rig_fault=polled.fault,
                work_time=work_time,
                wake_delay=wake_delay,
            )
        )

    def _values(self, reading: Reading) -> list[float]:
        """Values of the channels; the last omega where it is no longer measured."""
        if math.isfinite(reading.omega):
            self._omega = reading.omega
        elif "omega" in self._channels and not self._lost:
            self._lost = True
            self._rows.event(reading.time, Event.OMEGA_LOST)
        reading = reading._replace(omega=self._omega)
        return [getattr(reading, name) for name in self._channels]

    def _command(self, time: float, command: RigCommand) -> None:
        if self._driven:
            self._rows.command(time, command.omega, command.vx)
        else:
            self._rows.command(time, command.omega)
