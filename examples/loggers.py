"""Evaluate after every epoch, and log the scores: TensorBoard, MLflow or Weights & Biases.

``python loggers.py tensorboard`` (or ``mlflow``, ``wandb``) trains for three epochs and logs to the
working folder; nothing leaves the machine. The answers are samples, which ``reverie-eval demo``
writes there. ``scores.to_dict()`` holds plain numbers by name, which
is what each of them takes: fractions in [0, 1], lengths in metres. The signature belongs beside
them: it names everything that the numbers depend on, and numbers of equal signatures compare.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import reverie_eval as rv

SAMPLES = Path("demo")


def epochs() -> Iterator[tuple[int, Path]]:
    """Stand in for your training loop: an agent's answers after every epoch."""
    yield from enumerate([SAMPLES / f"{name}.json" for name in ("mediocre", "drawn", "good")])


def tensorboard(evaluator: rv.Evaluator) -> None:
    """Write event files: ``tensorboard --logdir runs`` shows them."""
    from tensorboardX import SummaryWriter  # or: from torch.utils.tensorboard import SummaryWriter

    with SummaryWriter("runs/my-agent") as writer:
        for epoch, predictions in epochs():
            scores = evaluator(predictions)
            for name, value in scores.to_dict().items():
                writer.add_scalar(f"val_unseen/{name}", value, epoch)
            writer.add_text("val_unseen/signature", scores.signature, epoch)


def mlflow(evaluator: rv.Evaluator) -> None:
    """Write a database: ``mlflow ui --backend-store-uri sqlite:///mlflow.db`` shows it."""
    import mlflow

    mlflow.set_tracking_uri("sqlite:///mlflow.db")
    mlflow.set_experiment("reverie")
    with mlflow.start_run(run_name="my-agent"):
        for epoch, predictions in epochs():
            scores = evaluator(predictions)
            metrics = {f"val_unseen/{name}": value for name, value in scores.to_dict().items()}
            mlflow.log_metrics(metrics, step=epoch)
            mlflow.set_tag("val_unseen/signature", scores.signature)


def wandb(evaluator: rv.Evaluator) -> None:
    """Write an offline run: ``wandb sync wandb/offline-run-*`` sends it, if you want to."""
    import wandb

    with wandb.init(project="reverie", name="my-agent", mode="offline") as run:
        for epoch, predictions in epochs():
            scores = evaluator(predictions)
            run.log(
                {f"val_unseen/{name}": value for name, value in scores.to_dict().items()}, epoch
            )
            run.config["val_unseen/signature"] = scores.signature


LOGGERS = {"tensorboard": tensorboard, "mlflow": mlflow, "wandb": wandb}

if __name__ == "__main__":
    LOGGERS[sys.argv[1]](rv.Evaluator(split="val_unseen"))
