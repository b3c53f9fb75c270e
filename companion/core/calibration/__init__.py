"""An airframe identified from its own flight logs. What flies never imports this room."""
