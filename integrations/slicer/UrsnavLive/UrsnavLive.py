"""3D Slicer shows where ursnav_torch has the ureteroscope, what was seen of the kidney, and what it exports.

This file is the half that touches Slicer's scene; the other is UrsnavLiveLib.
"""

import qt
import slicer
import vtk
from slicer.ScriptedLoadableModule import (
    ScriptedLoadableModule,
    ScriptedLoadableModuleLogic,
    ScriptedLoadableModuleTest,
    ScriptedLoadableModuleWidget,
)
from UrsnavLiveLib import Picture, Points, Pose, Receiver, find_exports, read_stones

POLL_MS = 50
#: Colors of the verdicts on a calyx.
COLORS = {"inspected": (0.2, 0.7, 0.3), "glimpsed": (0.9, 0.8, 0.2), "unseen": (0.85, 0.25, 0.2)}
OUT_OF_REACH = (0.6, 0.6, 0.6)


class UrsnavLive(ScriptedLoadableModule):
    """The module's description."""

    def __init__(self, parent):
        super().__init__(parent)
        parent.title = "Ursnav Live"
        parent.categories = ["IGT"]
        parent.dependencies = []
        parent.contributors = ["ursnav_torch"]
        parent.helpText = "Shows the ureteroscope where ursnav_torch has it. Research software, not a medical device."
        parent.acknowledgementText = ""


class UrsnavLiveWidget(ScriptedLoadableModuleWidget):
    """A line for host and port, buttons, and the table of calyces."""

    def setup(self):
        super().setup()
        self.logic = UrsnavLiveLogic()
        form = qt.QFormLayout()
        self.layout.addLayout(form)
        self.host = qt.QLineEdit("127.0.0.1")
        self.port = qt.QSpinBox()
        self.port.setRange(1, 65535)
        self.port.setValue(18944)
        self.frame = qt.QComboBox()
        self.frame.addItems(["lps", "ras"])
        self.connectButton = qt.QPushButton("Connect")
        self.loadButton = qt.QPushButton("Load exports...")
        self.state = qt.QLabel("not connected")
        self.table = qt.QTableWidget(0, 3)
        self.table.setHorizontalHeaderLabels(["calyx", "verdict", "seen"])
        for label, widget in (("Host", self.host), ("Port", self.port), ("Frame of stones.csv", self.frame)):
            form.addRow(label, widget)
        for widget in (self.connectButton, self.loadButton, self.state, self.table):
            form.addRow(widget)
        self.connectButton.connect("clicked()", self.onConnect)
        self.loadButton.connect("clicked()", self.onLoad)
        self.timer = qt.QTimer()
        self.timer.setInterval(POLL_MS)
        self.timer.connect("timeout()", self.onTimer)

    def cleanup(self):
        self.timer.stop()
        self.logic.receiver.close()

    def onConnect(self):
        if self.logic.receiver.is_connected:
            self.timer.stop()
            self.logic.receiver.close()
        else:
            try:
                self.logic.connect(self.host.text, self.port.value)
                self.timer.start()
            except OSError as error:
                self.logic.receiver.problem = f"nobody listens there ({error})"
        self.show()

    def onTimer(self):
        if self.logic.update():
            self.show()

    def onLoad(self):
        folder = qt.QFileDialog.getExistingDirectory(None, "Folder from: ursnav export to=slicer")
        if not folder:
            return
        try:
            self.logic.load(folder, self.frame.currentText)
        except ValueError as error:
            slicer.util.errorDisplay(str(error))

    def show(self):
        """Bring state and table up to date."""
        receiver = self.logic.receiver
        self.connectButton.text = "Disconnect" if receiver.is_connected else "Connect"
        self.state.text = self.logic.words()
        self.table.setRowCount(len(receiver.coverage))
        for row, (name, (verdict, share)) in enumerate(receiver.coverage.items()):
            for column, text in enumerate((name, verdict, f"{share:.0%}")):
                self.table.setItem(row, column, qt.QTableWidgetItem(text))


class UrsnavLiveLogic(ScriptedLoadableModuleLogic):
    """From what comes to Slicer's nodes."""

    def __init__(self):
        super().__init__()
        self.receiver = Receiver()
        self.was = None

    def connect(self, host, port):
        """Connect to a sender.

        Raises:
            OSError: nobody listens there.
        """
        self.receiver.close()
        self.receiver = Receiver(host, port)
        self.receiver.connect()

    def words(self):
        """How it stands, in words."""
        if self.receiver.problem:
            return self.receiver.problem
        if not self.receiver.is_connected:
            return "not connected"
        return "connected; no new pose" if self.receiver.is_old else "connected"

    def update(self):
        """Show what has come; whether anything that the widget shows has changed."""
        for message in self.receiver.poll():
            if isinstance(message, Pose) and message.matrix is not None:
                self.showPose(message)
            elif isinstance(message, Picture):
                self.showPicture(message)
            elif isinstance(message, Points):
                self.showPoints(message.device, message.names, message.at)
        now = (self.words(), dict(self.receiver.coverage))
        changed, self.was = now != self.was, now
        if changed:
            self.colorCalyces()
        return changed

    def showPose(self, pose):
        node = self.node("vtkMRMLLinearTransformNode", pose.device)
        node.SetMatrixTransformToParent(slicer.util.vtkMatrixFromArray(pose.matrix))
        if slicer.mrmlScene.GetFirstNodeByName("ScopeTip") is None:
            self.addCone(node)

    def addCone(self, transform):
        """A cone that looks along the camera's z, its tip at the camera."""
        cone = vtk.vtkConeSource()
        cone.SetHeight(6.0)
        cone.SetRadius(2.0)
        cone.SetDirection(0.0, 0.0, -1.0)
        cone.SetCenter(0.0, 0.0, 3.0)
        cone.Update()
        model = slicer.modules.models.logic().AddModel(cone.GetOutputPort())
        model.SetName("ScopeTip")
        model.SetAndObserveTransformNodeID(transform.GetID())

    def showPicture(self, picture):
        kind = "vtkMRMLVectorVolumeNode" if picture.pixels.ndim == 3 else "vtkMRMLScalarVolumeNode"
        node = self.node(kind, picture.device)
        slicer.util.updateVolumeFromArray(node, picture.pixels[None])
        node.SetIJKToRASMatrix(slicer.util.vtkMatrixFromArray(picture.ijk_to_ras))
        pose = slicer.mrmlScene.GetFirstNodeByName("CameraToKidney")
        if pose is not None:
            node.SetAndObserveTransformNodeID(pose.GetID())

    def showPoints(self, name, names, at):
        node = self.node("vtkMRMLMarkupsFiducialNode", name)
        slicer.util.updateMarkupsControlPointsFromArray(node, at)
        for index, text in enumerate(names):
            node.SetNthControlPointLabel(index, text)

    def colorCalyces(self):
        """Color every calyx's own point list by its verdict; `load` has made one a calyx."""
        for name, (verdict, _) in self.receiver.coverage.items():
            node = slicer.mrmlScene.GetFirstNodeByName(f"calyx {name}")
            if node is not None and node.GetDisplayNode() is not None:
                node.GetDisplayNode().SetSelectedColor(*COLORS.get(verdict, OUT_OF_REACH))

    def load(self, folder, frame="lps"):
        """Load an export.

        Raises:
            ValueError: the folder is none, or a file in it is not what its name says.
        """
        for item in find_exports(folder):
            if item.kind == "model":
                node = slicer.util.loadModel(str(item.path))
                node.GetDisplayNode().SetOpacity(0.3)
            elif item.kind == "transform":
                slicer.util.loadTransform(str(item.path))
            elif item.kind == "stones":
                self.showPoints("Stones", *read_stones(item.path, frame))
            else:
                node = slicer.util.loadMarkups(str(item.path))
                if item.name == "calyces":
                    self.split(node)

    def split(self, node):
        """A list a calyx, so that each can have its own color."""
        points = slicer.util.arrayFromMarkupsControlPoints(node, world=True)
        for index in range(node.GetNumberOfControlPoints()):
            name = node.GetNthControlPointLabel(index)
            if name != "pelvis":
                self.showPoints(f"calyx {name}", (name,), points[index : index + 1])
        node.GetDisplayNode().SetVisibility(False)

    @staticmethod
    def node(kind, name):
        """The node of that name, made where it is not there."""
        found = slicer.mrmlScene.GetFirstNodeByName(name)
        return found if found is not None else slicer.mrmlScene.AddNewNodeByClass(kind, name)


class UrsnavLiveTest(ScriptedLoadableModuleTest):
    """What Slicer's own test button runs."""

    def runTest(self):
        slicer.mrmlScene.Clear()
        logic = UrsnavLiveLogic()
        assert logic.words() == "not connected"
        assert logic.update() and not logic.update()
