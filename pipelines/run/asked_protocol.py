"""A protocol as a user asks for it, known to be computable before anything is read."""

from ggvs_eval.errors import MetricError, ProtocolError
from ggvs_eval.metrics.registry import METRICS, select_metrics
from ggvs_eval.protocol import Protocol, load_protocol, packaged_protocols


def asked_protocol(source: str) -> Protocol:
    """Load a protocol and refuse metrics that there are not.

    A packaged protocol may name metrics whose package is not installed; these are not computed.

    Raises:
        ProtocolError: no such protocol, or one that makes no sense; a mistyped metric is named with the nearest one.
    """
    protocol = load_protocol(source)
    try:
        select_metrics(protocol.measurement.metrics)
        absent = next(filter(None, map(METRICS.why_absent, protocol.measurement.metrics)), None)
        if absent and source not in packaged_protocols():
            raise MetricError(absent)
    except MetricError as error:
        raise ProtocolError(f"{source}: measurement.metrics: {error}") from None
    return protocol
