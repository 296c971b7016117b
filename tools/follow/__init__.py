"""`polemap localize --follow`: the pose while a drive is being recorded."""
