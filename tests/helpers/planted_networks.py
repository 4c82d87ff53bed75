"""Exported networks that do more than compute: they write a file, or read one of others."""

import io

import torch

__all__ = ["Writes", "WritesAtLoading", "WritesInABranch", "onnx_beside", "script_of"]


def script_of(module: torch.nn.Module) -> bytes:
    """The content of a TorchScript file."""
    stream = io.BytesIO()
    torch.jit.save(torch.jit.script(module), stream)  # type: ignore[no-untyped-call]
    return stream.getvalue()


def onnx_beside(location: str) -> bytes:
    """An ONNX file of a network of two inputs, whose weights are in another file."""
    import onnx

    weights = onnx.TensorProto(name="w", data_type=1, dims=[2])
    weights.data_location = onnx.TensorProto.EXTERNAL
    weights.external_data.add(key="location", value=location)
    values = [onnx.helper.make_tensor_value_info(n, 1, ["N", 2]) for n in ("a", "b")]
    node = onnx.helper.make_node("Add", ["a", "w"], ["b"])
    graph = onnx.helper.make_graph([node], "g", values[:1], values[1:], [weights])
    version = [onnx.helper.make_opsetid("", 17)]
    model = onnx.helper.make_model(graph, opset_imports=version, ir_version=9)
    content: bytes = model.SerializeToString()
    return content


class Writes(torch.nn.Module):
    """Writes a file when it acts."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        kept = torch.from_file("PWNED", shared=True, size=2, dtype=torch.float32)
        return x[:, :2] + kept.fill_(1.0)


class WritesInABranch(torch.nn.Module):
    """Writes a file, in a branch of a loop of a function."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        for _ in range(2):
            if x.sum() > -1.0:
                x = x + _touched()
        return x


def _touched() -> torch.Tensor:
    return torch.from_file("PWNED", shared=True, size=1, dtype=torch.float32).fill_(1.0)


class WritesAtLoading(torch.nn.Module):
    """Has a method that runs while the file is loaded."""

    @torch.jit.export
    def __getstate__(self):
        return (3, self.training)

    @torch.jit.export
    def __setstate__(self, state: tuple[int, bool]):
        self.training = state[1]

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x[:, :2]
