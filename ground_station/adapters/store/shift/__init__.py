"""What a shift of dispatchers needs: days, hand-over and packs."""
