from .scenario import DiskArrayScenario as DiskArrayScenario
from .simulate import DiskArrayResult as DiskArrayResult
from .simulate import push_disk_array as push_disk_array
from .simulate import simulate_disk_array as simulate_disk_array
