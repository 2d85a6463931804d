"""Where the scores of sweeps are kept: ``base`` says what a store is; only ``mlflow`` knows MLflow."""
