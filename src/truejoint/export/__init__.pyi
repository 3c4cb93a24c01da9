from .export_c import check_command as check_command
from .export_c import default_prefix as default_prefix
from .export_c import export_c as export_c
from .export_c import export_ros as export_ros
from .export_onnx import export_onnx as export_onnx
from .export_urdf import export_urdf as export_urdf
