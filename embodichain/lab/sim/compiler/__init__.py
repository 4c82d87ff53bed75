"""From declared configs to one MuJoCo model. Nothing here steps physics or imports torch."""
