"""Follow a value through the code, from the command to where it is used up: ``python docs/value_walk.py [ROOT]``.

The walk of `capture` starts at `evaluate` and goes into every function that is handed the capture or something that holds it, in
the order of the calls: into each call, as a program does, or into each function once, as a reader does. A stay is a stretch of
the walk in one module; a return is a stay in a module that was left before.

Nothing is run. What an expression is follows from annotations of parameters, of fields and of what functions return. An object is
told by the classes that its annotation names, so that a list of captures is a capture, too.
"""

import ast
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("ggvs_eval", "baselines", "metrics", "pipelines", "reports")
FOLLOWED = {"capture": "Capture", "protocol": "Protocol"}  # a value's name -> its class
Function = ast.FunctionDef | ast.AsyncFunctionDef
Types = frozenset[str]  # names of classes, as ``module.Class``
NONE: Types = frozenset()


@dataclass
class Module:
    """Module of the checkout: its definitions, and the meaning of the names in it.

    Attributes:
        name: dotted.
        functions: by name, methods as ``Class.method``.
        classes: by name.
        imported: local name -> dotted name of what it stands for.
    """

    name: str
    functions: dict[str, Function] = field(default_factory=dict)
    classes: dict[str, ast.ClassDef] = field(default_factory=dict)
    imported: dict[str, str] = field(default_factory=dict)


class Code:
    """The code of a checkout, its names resolved.

    Args:
        root: the checkout.
    """

    def __init__(self, root: Path) -> None:
        self.modules: dict[str, Module] = {}
        for folder in FOLDERS:
            for file in sorted((root / folder).rglob("*.py")):
                name = ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
                name = name if name.split(".")[0] == "ggvs_eval" else f"ggvs_eval.{name}"
                self.modules[name] = _module(name, ast.parse(file.read_text(encoding="utf-8")))

    def resolve(self, module: Module, name: str) -> str:
        """The dotted name of what a name stands for in a module; empty where that is not of this package."""
        if name in module.functions or name in module.classes:
            return f"{module.name}.{name}"
        dotted = module.imported.get(name, "")
        owner, _, inner = dotted.rpartition(".")
        if owner != module.name and dotted not in self.modules and inner in self._imports(owner):
            return self.resolve(self.modules[owner], inner)  # a package that hands on a name
        return dotted

    def _imports(self, module: str) -> dict[str, str]:
        return self.modules[module].imported if module in self.modules else {}

    def find_class(self, dotted: str) -> tuple[Module, ast.ClassDef] | None:
        """A class and its module."""
        module = self.modules.get(dotted.rpartition(".")[0])
        name = dotted.rpartition(".")[2]
        return (module, module.classes[name]) if module and name in module.classes else None

    def find_function(self, dotted: str) -> tuple[Module, str] | None:
        """A function, a method or what a class does when it is made: its module and name there."""
        for cut in range(dotted.count(".") + 1):
            owner, inner = ".".join(dotted.split(".")[: cut + 1]), ".".join(dotted.split(".")[cut + 1 :])
            module = self.modules.get(owner)
            if module is None or not inner:
                continue
            makers = [f"{inner}.__init__", f"{inner}.__post_init__"] if inner in module.classes else [inner]
            for name in makers:
                if name in module.functions:
                    return module, name
        return None

    def named(self, module: Module, annotation: ast.expr | None) -> Types:
        """The classes of this package that an annotation names."""
        if annotation is None:
            return NONE
        types = set()
        for node in ast.walk(annotation):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                with suppress(SyntaxError):  # words of a Literal
                    types |= self.named(module, ast.parse(node.value, mode="eval").body)
            dotted = self.resolve(module, node.id) if isinstance(node, ast.Name) else ""
            if self.find_class(dotted):
                types.add(dotted)
        return frozenset(types)

    def member(self, owners: Types, name: str) -> tuple[Types, list[str]]:
        """Resolve an attribute of objects of these classes: its types, and the methods or properties behind it."""
        types, methods = set(), []
        for dotted in sorted(owners):
            module, definition = self.find_class(dotted) or (None, None)
            while module and definition:
                method = module.functions.get(f"{definition.name}.{name}")
                if method:
                    methods.append(f"{module.name}.{definition.name}.{name}")
                    types |= self.named(module, method.returns)
                    break
                annotation = self._field(module, definition, name)
                if annotation is not None:
                    types |= self.named(module, annotation)
                    break
                bases = [self.resolve(module, base.id) for base in definition.bases if isinstance(base, ast.Name)]
                module, definition = next((each for base in bases if (each := self.find_class(base))), (None, None))
        return frozenset(types), methods

    def _field(self, module: Module, definition: ast.ClassDef, name: str) -> ast.expr | None:
        """The annotation of a field, or of the parameter of ``__init__`` that is kept under its name."""
        for node in definition.body:
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == name:
                return node.annotation
        parameters = _parameters(module.functions.get(f"{definition.name}.__init__"))
        return next((each.annotation for each in parameters if each.arg == name.removeprefix("_")), None)

    def holders(self, name: str) -> Types:
        """The class of that name and all that hold one, directly or in what they hold."""
        held = {f"{module.name}.{name}" for module in self.modules.values() if name in module.classes}
        while True:
            more = {dotted for dotted, types in self._fields.items() if types & held} - held
            if not more:
                return frozenset(held)
            held |= more

    @cached_property
    def _fields(self) -> dict[str, Types]:
        """Class -> classes of its fields."""
        return {
            f"{module.name}.{name}": frozenset().union(
                *(self.named(module, node.annotation) for node in definition.body if isinstance(node, ast.AnnAssign)),
                *(self.named(module, each.annotation) for each in _parameters(module.functions.get(f"{name}.__init__"))),
            )
            for module in self.modules.values()
            for name, definition in module.classes.items()
        }


class Walk(ast.NodeVisitor):
    """One walk; visits the calls of a function in their order.

    Args:
        code: where to walk.
        followed: classes of the value and of what holds it.

    Attributes:
        path: functions in the order in which the value is handed to them, as (module, name).
    """

    def __init__(self, code: Code, followed: Types) -> None:
        self.path: list[tuple[str, str]] = []
        self._within: tuple[tuple[str, str], ...] = ()
        self._code, self._followed = code, followed
        self._module, self._types_of = Module(""), dict[str, Types]()

    def enter(self, module: Module, name: str, handed: bool) -> None:
        """Go through a function, but not into what calls it; it is on the path if it is handed the value."""
        step = module.name, name
        if handed:
            self.path.append(step)
        if step in self._within:
            return
        outside = self._module, self._types_of, self._within
        self._within = (*self._within, step)
        function, owner = module.functions[name], name.rpartition(".")[0]
        self._module = module
        self._types_of = {each.arg: self._code.named(module, each.annotation) for each in _parameters(function)}
        if owner in module.classes:
            self._types_of["self"] = self._types_of["cls"] = frozenset({f"{module.name}.{owner}"})
        for node in function.body:
            self.visit(node)
        self._module, self._types_of, self._within = outside

    def visit_Assign(self, node: ast.Assign) -> None:
        """A variable is what is assigned to it."""
        self.generic_visit(node)
        for target in node.targets:
            self._name(target, self._types(node.value))

    def visit_For(self, node: ast.For) -> None:
        """Bind the target of a loop to what the loop runs over."""
        self._name(node.target, self._types(node.iter))
        self.generic_visit(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        """Bind the target of a comprehension to what it runs over."""
        self._name(node.target, self._types(node.iter))
        self.generic_visit(node)

    def visit_ListComp(self, node: ast.ListComp | ast.SetComp | ast.GeneratorExp | ast.DictComp) -> None:
        """Its loops come before its element."""
        for each in node.generators:
            self.visit(each)
        for part in ("key", "value", "elt"):
            if hasattr(node, part):
                self.visit(getattr(node, part))

    visit_SetComp = visit_GeneratorExp = visit_DictComp = visit_ListComp

    def visit_Call(self, node: ast.Call) -> None:
        """Go where the value goes: into the callee, if one of its arguments or its object holds the value."""
        self.generic_visit(node)
        arguments = [*node.args, *(each.value for each in node.keywords)]
        function = node.func
        if isinstance(function, ast.Name) and function.id == "partial" and arguments:
            function, *arguments = arguments
        receiver = [function.value] if isinstance(function, ast.Attribute) else []
        handed = any(self._types(each) & self._followed for each in [*arguments, *receiver])
        for dotted in self._callees(function):
            definition = self._code.find_function(dotted)
            if definition:
                self.enter(*definition, handed)

    def _callees(self, function: ast.expr) -> list[str]:
        if isinstance(function, ast.Name):
            return [self._code.resolve(self._module, function.id)]
        if isinstance(function, ast.Attribute):
            methods = self._code.member(self._types(function.value), function.attr)[1]
            owner = function.value.id if isinstance(function.value, ast.Name) else ""
            return methods or [f"{self._code.resolve(self._module, owner)}.{function.attr}"]
        return []

    def _types(self, node: ast.expr) -> Types:
        """The classes that an expression may be of."""
        if isinstance(node, ast.Name):
            return self._types_of.get(node.id, NONE)
        if isinstance(node, ast.Attribute):
            return self._code.member(self._types(node.value), node.attr)[0]
        if isinstance(node, ast.Call):
            return self._returned(node)
        if isinstance(node, ast.Compare | ast.Constant | ast.JoinedStr | ast.Lambda):
            return NONE
        if isinstance(node, ast.Subscript):
            return self._types(node.value)
        parts = [each for each in ast.iter_child_nodes(node) if isinstance(each, ast.expr)]
        return frozenset().union(*(self._types(each) for each in parts))

    def _returned(self, node: ast.Call) -> Types:
        """Infer the types that a call returns: the class itself, its annotation, or those that it copies or loops over."""
        if isinstance(node.func, ast.Name):
            dotted = self._code.resolve(self._module, node.func.id)
            if self._code.find_class(dotted):
                return frozenset({dotted})
            if node.func.id in ("replace", "tuple", "list", "sorted", "zip", "enumerate", "partial", "reversed"):
                return frozenset().union(*(self._types(each) for each in node.args))
            definition = self._code.find_function(dotted)
            return self._code.named(definition[0], definition[0].functions[definition[1]].returns) if definition else NONE
        if isinstance(node.func, ast.Attribute):
            types, methods = self._code.member(self._types(node.func.value), node.func.attr)
            is_of_dict = not methods and node.func.attr in ("items", "values", "get", "pop")
            return self._types(node.func.value) if is_of_dict else types
        return NONE

    def _name(self, target: ast.expr, types: Types) -> None:
        """Note what the names of a target are."""
        for node in ast.walk(target):
            if isinstance(node, ast.Name):
                self._types_of[node.id] = types


def _module(name: str, tree: ast.Module) -> Module:
    module = Module(name)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            module.imported |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.ClassDef):
            module.classes[node.name] = node
            module.functions |= {f"{node.name}.{each.name}": each for each in node.body if isinstance(each, Function)}
    module.functions |= {node.name: node for node in tree.body if isinstance(node, Function)}
    return module


def _parameters(function: Function | None) -> list[ast.arg]:
    if function is None:
        return []
    arguments = function.args
    return [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]


def walk(code: Code, name: str) -> list[tuple[str, str]]:
    """The functions that a value is handed to, as (module, name), call by call from `evaluate` on.

    Args:
        code: of a checkout.
        name: of the value, see `FOLLOWED`.
    """
    start = next(
        module for module in code.modules.values() if module.name.endswith(".evaluate") and "evaluate" in module.functions
    )
    steps = Walk(code, code.holders(FOLLOWED[name]))
    steps.enter(start, "evaluate", handed=True)
    return steps.path


def once(path: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """A walk that goes into each function once."""
    return list(dict.fromkeys(path))


def stays(path: list[tuple[str, str]]) -> tuple[int, int]:
    """Number of stays of a walk, and how many of them are returns."""
    modules = [module for module, _ in groupby(path, key=lambda step: step[0])]
    return len(modules), len(modules) - len(set(modules))


def main() -> None:
    """Print the walks of a checkout, this one unless another is given, and their lengths."""
    code = Code(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT)
    for name in FOLLOWED:
        path = walk(code, name)
        for module, steps in groupby(once(path), key=lambda step: step[0]):
            print(f"{module.removeprefix('ggvs_eval.')}: {', '.join(function for _, function in steps)}")
        print("{}: {} stays, {} of them returns; ".format(name, *stays(once(path))), end="")
        print("call by call {} and {}\n".format(*stays(path)))


if __name__ == "__main__":
    main()
