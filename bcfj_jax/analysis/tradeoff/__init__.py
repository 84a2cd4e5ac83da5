"""The trade between speed and accuracy of one scene, measured: settings, their errors, their cost, advice."""
