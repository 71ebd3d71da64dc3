"""Clean one channel: its filter, its faults and holes, the judgement of its model, and its report."""
