"""Sets of metrics that tests name again and again, written out rather than read from the code."""

BOX_METRICS = frozenset({"iou", "iou_25", "iou_50", "iou_75"})
"""What is scored only if there are predicted boxes."""

BINARY_METRICS = frozenset({"success", "oracle_success", "rgs", "iou_25", "iou_50", "iou_75"})
"""What an episode has or does not have."""
