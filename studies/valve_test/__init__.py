"""What a valve test shows: ``valve_test``: the gap; ``blame``: why the loop hunts."""
