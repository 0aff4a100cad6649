"""The implicit field: network, exact derivatives, and the metric–phase combination."""

from mpf_core.field.jet import Jet, Order
from mpf_core.field.metric_phase import FieldJets, MetricPhaseField

__all__ = ["FieldJets", "Jet", "MetricPhaseField", "Order"]
